//! The UDP side of a bridge: one socket, one controller, one thread.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use crate::bridge::message::MAX_PACKET;
use crate::bridge::rsi::Rsi;
use crate::bridge::statistics::{Counts, Spread, Times};

/// Longest wait for a packet before `stop` is checked.
const WAIT: Duration = Duration::from_millis(100);
/// Time without an answer after which every controller has ended its session: 100 cycles of 12 ms. Another controller may
/// then take over, and the correction of the same one begins at zero again.
const SILENCE: Duration = Duration::from_millis(1_200);
/// Silence after which a correction that is being withdrawn is left to the controller.
const PATIENCE: Duration = Duration::from_secs(3);
/// Longest time in which a correction that is being withdrawn may stay as it is: packets without axes hold it.
const WITHDRAWAL: Duration = Duration::from_secs(10);
/// Time between two reports.
const INTERVAL: Duration = Duration::from_secs(10);

/// State of a bridge, reported from time to time and at the end.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Counters since the start.
    pub counts: Counts,
    /// Cycle time in ms, if it is known.
    pub cycle_ms: Option<u64>,
    /// CPU times of a cycle with its system calls, where the system counts them.
    pub cpu_us: Option<Spread>,
    /// Largest correction of an axis in the last answer, in degrees.
    pub applied_deg: f64,
}

/// Answers packets until `stop` is set or `cycles` cycles are answered, and then until the correction is zero or no packet
/// comes.
///
/// A report that the receiver does not take is dropped: a cycle never waits for it.
///
/// # Errors
/// What the socket cannot do.
pub fn serve(
    socket: &UdpSocket,
    rsi: &mut Rsi,
    cycles: Option<u64>,
    stop: &AtomicBool,
    reports: &SyncSender<Report>,
) -> io::Result<Report> {
    socket.set_read_timeout(Some(WAIT))?;
    let mut buffer = [0; MAX_PACKET + 1];
    let mut times = Times::default();
    let mut peer: Option<IpAddr> = None;
    // Time of the last answer.
    let mut heard = Instant::now();
    let mut reported = heard;
    let mut cpu = cpu_time();
    let mut cycles_before = 0;
    // While the correction is withdrawn: its size, and since when.
    let mut withdrawn: Option<(f64, Instant)> = None;
    loop {
        let stops =
            stop.load(Ordering::Relaxed) || cycles.is_some_and(|most| cycles_before >= most);
        if stops {
            rsi.stop();
            let applied = rsi.applied_deg();
            let (_, since) = *match &mut withdrawn {
                Some(last) if last.0 <= applied => last,
                last => last.insert((applied, Instant::now())),
            };
            let is_given_up = heard.elapsed() >= PATIENCE || since.elapsed() >= WITHDRAWAL;
            if rsi.is_at_zero() || is_given_up {
                break;
            }
        }
        match socket.recv_from(&mut buffer) {
            Ok((_, from))
                if peer.is_some_and(|ip| ip != from.ip()) && heard.elapsed() < SILENCE =>
            {
                rsi.count_foreign();
            }
            Ok((length, from)) => {
                if heard.elapsed() >= SILENCE {
                    rsi.end_session();
                }
                if let Some(answer) = rsi.answer(&buffer[..length]) {
                    // The queue is full or the cable is out: for the controller, the answer is lost.
                    let _ = socket.send_to(answer, from);
                    peer = Some(from.ip());
                    heard = Instant::now();
                }
            }
            // No packet has come, or (on Windows) an earlier answer found no receiver.
            Err(error) if is_pause(error.kind()) => {}
            Err(error) => return Err(error),
        }
        let now = cpu_time();
        let done = rsi.counts().cycles;
        if let (Some(before), Some(now), true) = (cpu, now, done > cycles_before) {
            times.add(now.saturating_sub(before));
        }
        (cpu, cycles_before) = (now, done);
        if heard.duration_since(reported) >= INTERVAL {
            reported = heard;
            let _ = reports.try_send(report(rsi, &times));
            cpu = cpu_time();
        }
    }
    Ok(report(rsi, &times))
}

fn is_pause(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::WouldBlock
            | ErrorKind::TimedOut
            | ErrorKind::Interrupted
            | ErrorKind::ConnectionReset
            | ErrorKind::ConnectionRefused
    )
}

fn report(rsi: &Rsi, times: &Times) -> Report {
    Report {
        counts: rsi.counts(),
        cycle_ms: rsi.cycle_ms(),
        cpu_us: times.spread(),
        applied_deg: rsi.applied_deg(),
    }
}

/// Returns the CPU time of this thread, in ns.
#[cfg(target_os = "linux")]
fn cpu_time() -> Option<u64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).ok()?;
    Some(seconds * 1_000_000_000 + u64::try_from(time.tv_nsec).ok()?)
}

/// Returns `None`: this system does not count the CPU time of the thread.
#[cfg(not(target_os = "linux"))]
fn cpu_time() -> Option<u64> {
    None
}
