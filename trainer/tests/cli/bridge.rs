//! `trainer bridge rsi` on the loopback. A simulated controller moves an arm whose errors no model contains, and its network
//! loses, repeats, delays and damages packets. The judge knows which datagrams must be answered, and waits for each answer.

use std::collections::VecDeque;
#[cfg(target_os = "linux")]
use std::net::UdpSocket;
#[cfg(unix)]
use std::process::{Child, Command};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::fake_controller::{Arm, Bridge, SPEED, blob, packet};
use crate::program::Folder;
use crate::texts::texts;

/// The largest step of an answer in millionths of a degree: the bridge's default.
const RAMP: i64 = 50_000;
/// Cycles until the whole correction is applied: those in which the bridge learns the cycle time, and half a second.
const BEGINNING: u64 = 250;

/// Returns a datagram that is not a packet.
fn garbage(good: &str, random: &mut ChaCha8Rng) -> Vec<u8> {
    let bytes = good.as_bytes();
    match random.random_range(0..6) {
        0 => (0..random.random_range(0..200))
            .map(|_| random.random())
            .collect(),
        1 => bytes[..random.random_range(0..bytes.len() - 6)].to_vec(),
        2 => good.replace("Rob", "Sen").into_bytes(),
        3 => good.replace("<IPOC>", "<IPOC>-").into_bytes(),
        4 => format!("{good}{}", " ".repeat(5000)).into_bytes(),
        _ => good.replace("<IPOC>", "<IPOC>777").into_bytes(),
    }
}

/// Returns a packet that must be answered although its axes cannot be read.
fn without_axes(good: &str, random: &mut ChaCha8Rng) -> String {
    let numbers = ["NaN", "inf", "-1e999", "", "0x10"];
    let number = numbers[random.random_range(0..numbers.len())];
    let (before, after) = good.split_once("<ASPos A1=\"").unwrap();
    let (_, after) = after.split_once('"').unwrap();
    format!("{before}<ASPos A1=\"{number}\"{after}")
}

/// The judge's counts.
#[derive(Debug, Default)]
struct Judged {
    packets: u64,
    sent: u64,
    cycles: u64,
    dropped: u64,
    duplicates: u64,
    late: u64,
    garbage: u64,
    refused: u64,
    answers_lost: u64,
    largest_step: i64,
    before_mm: Vec<f64>,
    after_mm: Vec<f64>,
}

/// Runs a session of `cycles` answered cycles, with or without faults, until the bridge has withdrawn the correction.
fn drive(
    arm: &mut Arm,
    bridge: &Bridge,
    cycles: u64,
    cycle_ms: u64,
    faults: bool,
    is_actual: bool,
) -> Judged {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut judged = Judged::default();
    // The time stamp of a controller that has run for some days.
    let first = 123_456_780_000;
    let (mut s, mut ipoc) = (0.0, first);
    let (mut applied, mut last) = ([0; 6], [0; 6]);
    let mut delayed: VecDeque<(u64, u64, String)> = VecDeque::new();
    for number in 0.. {
        let joints = arm.path(s);
        let is_whole = judged.cycles > BEGINNING && judged.cycles < cycles;
        if is_whole {
            judged.before_mm.push(arm.error_mm(&joints, &[0; 6]));
            judged.after_mm.push(arm.error_mm(&joints, &applied));
        }
        let good = packet(ipoc, &joints, &applied, is_actual);
        let ends = judged.cycles >= cycles;
        // No faults in the first packet, which begins the session.
        let mut fault =
            |share: f64| faults && number > 0 && !ends && random.random::<f64>() < share;
        let (drops, delays, repeats) = (fault(0.02), fault(0.02), fault(0.02));
        let (spoils, blinds, forgets) = (fault(0.02), fault(0.01), fault(0.01));
        judged.packets += 1;
        if spoils {
            bridge.send(&garbage(&good, &mut random));
            judged.sent += 1;
            judged.garbage += 1;
        }
        if drops {
            judged.dropped += 1;
        } else if delays {
            delayed.push_back((number + 1 + random.random_range(0..3), ipoc, good));
        } else {
            let text = if blinds {
                without_axes(&good, &mut random)
            } else {
                good
            };
            bridge.send(text.as_bytes());
            let (stamp, correction) = bridge.answer();
            assert_eq!(stamp, ipoc, "the answer to another packet");
            judged.sent += 1;
            judged.cycles += 1;
            judged.refused += u64::from(blinds);
            for (now, before) in correction.iter().zip(&last) {
                judged.largest_step = judged.largest_step.max((now - before).abs());
            }
            assert!(
                !blinds || correction == last,
                "a step although the packet has no axes"
            );
            last = correction;
            if repeats {
                bridge.send(text.as_bytes());
                assert_eq!(bridge.answer(), (stamp, correction));
                judged.sent += 1;
                judged.duplicates += 1;
            }
            if forgets {
                judged.answers_lost += 1;
            } else {
                applied = correction;
            }
            // Delayed packets arrive too late, some of them twice.
            while delayed
                .front()
                .is_some_and(|(due, ..)| *due <= number || ends)
            {
                let (_, _, text) = delayed.pop_front().unwrap();
                for _ in 0..1 + u64::from(repeats) {
                    bridge.send(text.as_bytes());
                    judged.sent += 1;
                }
                judged.late += 1;
                judged.duplicates += u64::from(repeats);
            }
            if ends && correction == [0; 6] {
                break;
            }
        }
        assert!(
            number < 2 * cycles + 1_000,
            "the correction is not withdrawn"
        );
        ipoc += cycle_ms;
        s = arm.advance(s, 1e-3 * cycle_ms as f64);
    }
    assert!(delayed.is_empty());
    judged
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Asserts that judge and bridge have the same counts, and that each cycle has its entry.
fn assert_same(judged: &Judged, document: &Value) {
    let of = |key: &str| document[key].as_u64().unwrap();
    let found = [
        "received",
        "cycles",
        "duplicates",
        "late",
        "lost",
        "garbage",
        "refused",
    ]
    .map(of);
    let expected = [
        judged.sent,
        judged.cycles,
        judged.duplicates,
        judged.late,
        judged.dropped,
        judged.garbage,
        judged.refused,
    ];
    assert_eq!(found, expected, "{judged:?}");
    assert_eq!(of("cycles") + of("late") + of("lost"), judged.packets);
    assert_eq!((of("sessions"), of("foreign"), of("withdrawn")), (1, 0, 0));
    assert_eq!(document["applied_deg"], 0.0);
}

/// Returns the median CPU time in µs in which a thread waits for a packet, sends it back and reads its clock: what the
/// kernel of this machine needs for a cycle.
#[cfg(all(target_os = "linux", not(debug_assertions)))]
fn bare_cycle() -> f64 {
    use rustix::time::{ClockId, clock_gettime};
    const PACKETS: usize = 2_000;
    let [here, there] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let address = there.local_addr().unwrap();
    let echo = std::thread::spawn(move || {
        let mut times = Vec::new();
        let mut buffer = [0; 2_048];
        let now = || {
            let time = clock_gettime(ClockId::ThreadCPUTime);
            1e6 * time.tv_sec as f64 + 1e-3 * time.tv_nsec as f64
        };
        let mut before = now();
        for _ in 0..PACKETS {
            let (length, from) = there.recv_from(&mut buffer).unwrap();
            there.send_to(&buffer[..length], from).unwrap();
            let after = now();
            times.push(after - before);
            before = after;
        }
        times.sort_by(f64::total_cmp);
        times[PACKETS / 2]
    });
    let mut answer = [0; 2_048];
    for _ in 0..PACKETS {
        here.send_to(&[b'x'; 512], address).unwrap();
        here.recv_from(&mut answer).unwrap();
    }
    echo.join().unwrap()
}

/// The evidence for the interface: 10 000 cycles of 4 ms, each answered, no answer with a step, and the real tool on its path.
#[test]
fn ten_thousand_cycles_take_little_time() {
    let folder = Folder::new();
    let bridge = Bridge::start(&folder, "--cycles 10000");
    let mut arm = Arm::new();
    let judged = drive(&mut arm, &bridge, 10_000, 4, true, false);
    let (said, document) = bridge.end(&folder);
    assert_same(&judged, &document);
    assert!(
        judged.largest_step <= RAMP && judged.largest_step > 0,
        "{}",
        judged.largest_step
    );
    assert_eq!(document["cycle_ms"], 4);
    let (before, after) = (mean(&judged.before_mm), mean(&judged.after_mm));
    let worst = judged.after_mm.iter().copied().fold(0.0, f64::max);
    let cpu = &document["cpu_us"];
    println!(
        "rsi: {} packets, {} answered, {} dropped, {} late, {} repeated, {} garbage, {} without axes, {} answers lost",
        judged.packets,
        judged.cycles,
        judged.dropped,
        judged.late,
        judged.duplicates,
        judged.garbage,
        judged.refused,
        judged.answers_lost
    );
    println!(
        "rsi: at {SPEED} m/s {before:.3} mm without, {after:.4} mm with it ({worst:.4} mm at most; {} cycles near a \
        singularity)",
        document["partly_corrected"]
    );
    println!(
        "rsi: largest step {:.6}°, CPU of a cycle in us: {cpu}",
        1e-6 * judged.largest_step as f64
    );
    for (what, count) in [
        ("dropped", judged.dropped),
        ("late", judged.late),
        ("repeated", judged.duplicates),
        ("garbage", judged.garbage),
        ("without axes", judged.refused),
        ("answers lost", judged.answers_lost),
    ] {
        assert!(count >= 50, "{what}: {count}");
    }
    assert!(before > 0.5, "{before}");
    assert!(after <= 0.05, "{after}");
    assert!(said.contains("cycles answered"), "{said}");
    #[cfg(all(target_os = "linux", not(debug_assertions)))]
    {
        let bare = bare_cycle();
        let own = ["mean", "p50"].map(|key| cpu[key].as_f64().unwrap() - bare);
        println!("rsi: {bare:.1} us of a cycle are the kernel's, {own:.1?} its own (mean, median)");
        assert!(own.iter().all(|own| *own <= 20.0), "{cpu}, bare {bare}");
    }
}

/// The bridge reads actual values, which contain the correction, in cycles of 12 ms.
#[test]
fn actual_values_and_long_cycles() {
    let folder = Folder::new();
    let bridge = Bridge::start(&folder, "--cycles 1500 --setpoint AIPos");
    let mut arm = Arm::new();
    let judged = drive(&mut arm, &bridge, 1_500, 12, false, true);
    let (_, document) = bridge.end(&folder);
    assert_same(&judged, &document);
    assert_eq!(document["cycle_ms"], 12);
    assert!(judged.largest_step <= RAMP, "{}", judged.largest_step);
    let (before, after) = (mean(&judged.before_mm), mean(&judged.after_mm));
    println!("rsi: AIPos, 12 ms: {before:.3} mm without, {after:.4} mm with it");
    assert!(after <= 0.05, "{after}");
}

/// Ctrl-C ends a bridge without packets at once; with packets, the bridge withdraws the correction first.
#[cfg(unix)]
#[test]
fn ctrl_c_withdraws_the_correction() {
    let interrupt = |child: &Child| {
        let id = child.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success());
    };
    let folder = Folder::new();
    let bridge = Bridge::start(&folder, "");
    interrupt(&bridge.child);
    let (_, document) = bridge.end(&folder);
    assert_eq!(document["cycles"], 0);

    // Nine of ten packets may be lost during the withdrawal.
    for step in [1, 10] {
        let bridge = Bridge::start(&folder, "--ramp-deg-per-cycle 0.001");
        let joints = Arm::new().path(0.0);
        let (mut last, mut ipoc, mut packets, mut steps) = ([0; 6], 0, 0, 0);
        while packets < 600 || last != [0; 6] {
            bridge.send(packet(ipoc, &joints, &last, false).as_bytes());
            let (_, correction) = bridge.answer();
            for (now, before) in correction.iter().zip(&last) {
                steps = steps.max((now - before).abs());
            }
            last = correction;
            packets += 1;
            if packets == 600 {
                assert!(last.iter().any(|x| x.abs() > 10_000), "{last:?}");
                interrupt(&bridge.child);
            }
            assert!(packets < 1_200, "one packet in {step}: {last:?}");
            ipoc += if packets < 600 { 4 } else { 4 * step };
        }
        assert!(steps <= 1_000 && steps > 500, "{steps}");
        let (_, document) = bridge.end(&folder);
        assert_eq!(document["applied_deg"], 0.0);
    }
}

/// Another computer is not answered while the controller is, and does not influence the controller's answers.
#[cfg(target_os = "linux")]
#[test]
fn another_computer_is_not_answered() {
    let folder = Folder::new();
    let bridge = Bridge::start(&folder, "--cycles 300");
    let other = UdpSocket::bind("127.0.0.2:0").unwrap();
    other
        .connect(bridge.controller.peer_addr().unwrap())
        .unwrap();
    other.set_nonblocking(true).unwrap();
    let joints = Arm::new().path(0.0);
    let (mut last, mut foreign) = ([0; 6], 0);
    for cycle in 0..10_000_u64 {
        let ipoc = 4 * cycle;
        bridge.send(packet(ipoc, &joints, &last, false).as_bytes());
        let (stamp, correction) = bridge.answer();
        assert_eq!(stamp, ipoc);
        last = correction;
        if cycle < 300 {
            let text = packet(ipoc + 4, &[0.3; 8], &last, false);
            other.send(text.as_bytes()).unwrap();
            foreign += 1;
        } else if last == [0; 6] {
            break;
        }
    }
    assert!(
        other.recv(&mut [0; 1500]).is_err(),
        "another computer got an answer"
    );
    let (_, document) = bridge.end(&folder);
    assert_eq!(document["foreign"], foreign);
    assert_eq!(
        (&document["lost"], &document["duplicates"]),
        (&0.into(), &0.into())
    );
}

#[test]
fn models_and_arguments_that_do_not_fit() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("arm.blob", blob());
    let rsi = "bridge rsi arm.blob --listen";
    folder.refuses(format!("{rsi} 127.0.0.1:0"));
    folder.refuses(format!("{rsi} 127.0.0.1:0 --payload-kg -1"));
    folder.refuses(format!("{rsi} 127.0.0.1 --payload-kg 1"));
    folder.refuses(format!("{rsi} 203.0.113.1:59152 --payload-kg 1"));
    folder.refuses(format!("{rsi} 127.0.0.1:0 --payload-kg 1 --limit-deg 9"));
    folder.refuses(format!(
        "{rsi} 127.0.0.1:0 --payload-kg 1 --ramp-deg-per-cycle nan"
    ));
    folder.refuses(format!("{rsi} 127.0.0.1:0 --payload-kg 1 --setpoint RIst"));
    folder.write("short.blob", &blob()[..100]);
    folder.refuses("bridge rsi short.blob --listen 127.0.0.1:0");
    for line in [
        "simulate --robot kuka-iiwa7 --poses 40 --test-sets 0 --payloads 0 --out seven",
        "calibrate --robot kuka-iiwa7 seven/train.csv --method base-tool --out seven.blob",
    ] {
        folder.run(line).ok();
    }
    folder.refuses("bridge rsi seven.blob --listen 127.0.0.1:0");
}
