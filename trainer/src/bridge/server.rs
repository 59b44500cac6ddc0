//! The UDP side of a bridge: one socket, one controller, one thread.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use crate::bridge::message::MAX_PACKET;
use crate::bridge::rsi::Rsi;
use crate::bridge::statistics::{Counts, Spread, Times};

/// Longest wait for a packet before the stop is looked at.
const WAIT: Duration = Duration::from_millis(100);
/// Silence after which another controller may come.
const SILENCE: Duration = Duration::from_secs(1);
/// Silence after which a correction that is being withdrawn is left to the controller.
const PATIENCE: Duration = Duration::from_secs(3);
/// Time between two reports.
const INTERVAL: Duration = Duration::from_secs(10);

/// What is reported now and then, and at the end.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// What was counted.
    pub counts: Counts,
    /// The cycle time in ms, if it is known.
    pub cycle_ms: Option<u64>,
    /// CPU time of a cycle with its system calls, where the system counts it.
    pub cpu_us: Option<Spread>,
    /// Largest correction of the last answer, degrees.
    pub applied_deg: f64,
}

/// Answers packets until `stop` is set or `cycles` are answered, and then until the correction is zero or no packet comes.
///
/// A report that nobody takes is dropped: a cycle never waits for it.
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
    // When a packet was answered last.
    let mut heard = Instant::now();
    let mut reported = heard;
    let mut cpu = cpu_time();
    let mut cycles_before = 0;
    loop {
        let stops =
            stop.load(Ordering::Relaxed) || cycles.is_some_and(|most| cycles_before >= most);
        if stops {
            rsi.stop();
            if rsi.is_at_zero() || heard.elapsed() >= PATIENCE {
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
                if let Some(answer) = rsi.answer(&buffer[..length]) {
                    // A full queue or a cable that is out: the controller takes it for a lost answer.
                    let _ = socket.send_to(answer, from);
                    peer = Some(from.ip());
                    heard = Instant::now();
                }
            }
            // An answer before has found nobody (of Windows), or nothing has come.
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

/// CPU time of this thread in ns.
#[cfg(target_os = "linux")]
fn cpu_time() -> Option<u64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).ok()?;
    Some(seconds * 1_000_000_000 + u64::try_from(time.tv_nsec).ok()?)
}

/// CPU time of this thread: not counted here.
#[cfg(not(target_os = "linux"))]
fn cpu_time() -> Option<u64> {
    None
}
