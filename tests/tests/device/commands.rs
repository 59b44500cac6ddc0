//! The commands of a controller's cycle: a path with an activation and the bypass in the middle, and the cost of a command.

use poegp_protocol::link::cyclic::{answer_length, command_length};
use poegp_protocol::link::{Commanded, CycleSettings, Query};
use poegp_runtime::filter::GRACE;
use poegp_runtime::guard::status::Status;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, instructions};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::{CommandBits, Host};

use crate::device;

/// Fast settings, so that a test of a few seconds contains whole switches.
const CYCLE: CycleSettings = CycleSettings {
    period_us: 2_000,
    max_instructions: 62_500,
    rate: 0.02,
    acceleration: 2.0,
    blend_s: 0.05,
};

/// A controller on its path. Steps are changes of the correction that the device adds, in rad.
struct Controller {
    device: Device,
    middle: Query,
    place: f64,
    last: Option<(Query, Commanded)>,
    /// Largest step beyond what the path explains, rad.
    largest: f32,
    commands: u32,
}

impl Controller {
    fn command(&mut self) -> (Query, Commanded) {
        std::thread::sleep(std::time::Duration::from_millis(2));
        self.place += 0.02;
        let mut query = self.middle.clone();
        for joint in &mut query.joints {
            *joint += 0.05 * self.place.sin() as f32;
        }
        let commanded = self.device.command(&query).unwrap();
        if let Some((before, answer)) = &self.last {
            let numbers = query.joints.iter().zip(&commanded.joints);
            let earlier = before.joints.iter().zip(&answer.joints);
            for ((q, sent), (q_before, sent_before)) in numbers.zip(earlier) {
                let step = ((sent - q) - (sent_before - q_before)).abs();
                let explained = 0.5 * (q - q_before).abs() + 3e-6;
                self.largest = self.largest.max(step - explained);
            }
        }
        self.last = Some((query.clone(), commanded.clone()));
        self.commands += 1;
        (query, commanded)
    }

    /// Continues until nothing is blended any more and the weight is `weight`.
    fn settle(&mut self, weight: f32) -> (Query, Commanded) {
        for _ in 0..20_000 {
            let (query, commanded) = self.command();
            let blends = Status::from_bits(commanded.status).contains(Status::BLENDING);
            if !blends && commanded.weight.to_bits() == weight.to_bits() {
                return (query, commanded);
            }
        }
        panic!("the correction did not settle")
    }
}

#[test]
fn a_path_with_an_activation_in_the_middle() {
    let samples =
        [61, 62].map(|seed| Sample::plain(seed, SampleCorrection::Elastic(Elastic::PLAIN)));
    let hosts = [0, 1].map(|index: usize| Host::load(&samples[index].blob()).unwrap());
    let mut device = device();
    assert_eq!(
        device.client().provision_cycle(&CYCLE).unwrap().cycle,
        CYCLE
    );
    let identity = device.load(&samples[0].blob()).unwrap();
    assert!(!identity.pending, "without commands no model has to wait");
    let middle = samples[0].queries(1).remove(0);
    let apart = {
        let joints = hosts.each_ref().map(|host| host.command(&middle).joints());
        let differences = joints[0].iter().zip(&joints[1]).map(|(a, b)| (a - b).abs());
        differences.fold(0.0, f32::max)
    };
    let mut controller = Controller {
        device,
        middle,
        place: 0.0,
        last: None,
        largest: 0.0,
        commands: 0,
    };
    let (first, commanded) = controller.command();
    assert_eq!(
        commanded.joints, first.joints,
        "nothing is applied at first"
    );
    let (query, commanded) = controller.settle(1.0);
    assert_eq!(commanded.joints, hosts[0].command(&query).joints()[..]);

    // The new model is activated in mid-motion and has to wait.
    let crc = controller
        .device
        .client()
        .upload(&samples[1].blob(), &mut |_| ())
        .unwrap()
        .blob_crc;
    controller.settle(1.0);
    let identity = controller.device.client().activate(crc).unwrap();
    assert_eq!(identity.model.map(|model| model.blob_crc), Some(crc));
    assert!(identity.pending);
    let (mut old, mut exchanged) = (0, false);
    loop {
        let (_, commanded) = controller.command();
        exchanged |= commanded.blob_crc == crc;
        old += u32::from(!exchanged);
        assert_eq!(
            commanded.blob_crc == crc,
            exchanged,
            "the exchange is final"
        );
        if exchanged {
            break;
        }
    }
    let (query, commanded) = controller.settle(1.0);
    assert_eq!(commanded.joints, hosts[1].command(&query).joints()[..]);
    assert!(!controller.device.identify().unwrap().pending);

    controller.device.client().set_bypass(true).unwrap();
    let (query, commanded) = controller.settle(0.0);
    assert_eq!(commanded.joints, query.joints);
    // The weight reaches zero in the next cycles. Other remarks of the model stay in the status.
    let passes = (0..10).any(|_| {
        let (query, commanded) = controller.command();
        let status = Status::from_bits(commanded.status);
        let rests = status.contains(Status::BYPASSED) && !status.contains(Status::BLENDING);
        rests && commanded.joints == query.joints
    });
    assert!(passes);
    controller.device.client().set_bypass(false).unwrap();
    let (query, _) = controller.settle(1.0);
    let corrected = controller.device.correct(&query).unwrap();
    assert_eq!(CommandBits::from(&corrected), hosts[1].command(&query));

    // The same command in a cyclic frame.
    let cyclic = controller.device.client().cycle(&query).unwrap().unwrap();
    assert_eq!(cyclic.joints, hosts[1].command(&query).joints()[..]);
    assert_eq!(cyclic.status, corrected.status);

    // A late command may make up for several cycles at once.
    let allowed = GRACE as f32 * CYCLE.rate * CYCLE.period_us as f32 * 1e-6;
    println!(
        "{} commands, {old} of them while the old model was taken back; the models are {:.3} mrad apart, the largest step \
         beyond the path is {:.3} mrad of {:.3}",
        controller.commands,
        1e3 * apart,
        1e3 * controller.largest,
        1e3 * allowed
    );
    assert!(controller.largest <= allowed + 1e-6);
    let statistics = controller.device.statistics().unwrap();
    println!("{statistics:?}");
    assert_eq!((statistics.bad_commands, statistics.activations), (0, 2));
    controller.device.client().stand_down().unwrap();
    // The settings survive a restart.
    assert_eq!(controller.device.client().restart().unwrap().cycle, CYCLE);
}

/// The number of instructions is the same for every command except the first, early and invalid ones.
#[test]
fn instructions_of_a_command() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    println!("instructions, Cortex-M4F, 6 joints:           Correct  Command");
    for (name, correction) in [
        ("300 points, shared", SampleCorrection::Folded(300)),
        ("elastic", SampleCorrection::Elastic(Elastic::PLAIN)),
    ] {
        let sample = Sample::plain(63, correction);
        device.load(&sample.blob()).unwrap();
        let tick_hz = device.identify().unwrap().tick_hz;
        let query = &sample.queries(1)[0];
        device.command(query).unwrap();
        let correct = instructions(device.correct(query).unwrap().ticks, tick_hz);
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for number in 0..20 {
            let mut moved = query.clone();
            moved.joints[0] += 1e-4 * number as f32;
            let ticks = device.command(&moved).unwrap().ticks;
            let count = instructions(ticks, tick_hz);
            (least, most) = (least.min(count), most.max(count));
        }
        println!("  {name:<40}  {correct:8.0} {most:8.0}");
        assert!(most - correct <= 2_000.0, "{name}: {most}, {correct}");
        assert!(most - least <= 0.01 * most, "{name}: {least} to {most}");
        device.client().stand_down().unwrap();
    }
}

/// The cost of the frames of a command: the latency from its last byte to its answer, less correction and filter.
#[test]
fn instructions_of_the_frames_of_a_cycle() {
    let mut device = Device::start(Clock::Counting).unwrap_or_else(|error| panic!("{error}"));
    let sample = Sample::plain(64, SampleCorrection::Elastic(Elastic::PLAIN));
    let query = &sample.queries(1)[0];
    let mut costs = Vec::new();
    for cyclic in [false, true] {
        // A restart resets the counters.
        device.client().restart().unwrap();
        device.load(&sample.blob()).unwrap();
        // The restart cuts a frame, which counts as damaged.
        let before = device.statistics().unwrap().bad_frames;
        for number in 0..20 {
            let mut moved = query.clone();
            moved.joints[0] += 1e-4 * number as f32;
            if cyclic {
                assert!(device.client().cycle(&moved).unwrap().is_some());
            } else {
                device.command(&moved).unwrap();
            }
        }
        let counted = device.statistics().unwrap();
        assert_eq!((counted.cycles, counted.bad_frames), (20, before));
        let frames = counted.max_latency_ticks - counted.max_ticks;
        costs.push(instructions(frames, device.identify().unwrap().tick_hz));
        device.client().stand_down().unwrap();
    }
    let bytes = command_length(6) + answer_length(6);
    println!(
        "frames of a command of six joints, Cortex-M4F: {:.0} instructions in messages, {:.0} in {bytes} bytes of cyclic \
         frames: {:.1} per byte",
        costs[0],
        costs[1],
        costs[1] / bytes as f64
    );
    // The cost varies by a few percent with the number of bytes that arrive before the last one.
    assert!(costs[0] <= 6_000.0 && costs[1] <= 5_400.0, "{costs:?}");
}
