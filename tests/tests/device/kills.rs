//! Two hundred power cuts: the emulator is killed at random moments of upload, commit, activation and roll back, with its
//! flash in a file. After each start the device runs the old or the new model, whole, and has everything that it
//! acknowledged.

use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

use poegp_protocol::blob;
use poegp_protocol::link::Query;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, Machine};
use poegp_tests::firmware_build::{Board, firmware};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::{CommandBits, Host};
use poegp_trainer::device::client::Client;
use poegp_trainer::device::error::ClientError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const KILLS: usize = 200;

/// What the workstation is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Upload,
    Commit,
    Activate,
    RollBack,
}

/// The phases in their order, which repeats.
const PHASES: [Phase; 4] = [
    Phase::Upload,
    Phase::Commit,
    Phase::Activate,
    Phase::RollBack,
];

/// The phases of the kills; most kills come where flash is written.
const MOMENTS: [Phase; 8] = [
    Phase::Commit,
    Phase::RollBack,
    Phase::Upload,
    Phase::Commit,
    Phase::RollBack,
    Phase::Activate,
    Phase::Commit,
    Phase::RollBack,
];

/// A model with the host's answers.
struct Known {
    bytes: Vec<u8>,
    crc: u32,
    answers: Vec<CommandBits>,
}

fn models(queries: &[Query]) -> Vec<Known> {
    let small = Elastic {
        points: 30,
        ..Elastic::PLAIN
    };
    let corrections = [
        SampleCorrection::Elastic(small),
        SampleCorrection::Shared(60),
        SampleCorrection::PerOutput(90),
    ];
    let known = corrections.into_iter().zip(90..).map(|(correction, seed)| {
        let bytes = Sample::plain(seed, correction).blob();
        let host = Host::load(&bytes).unwrap();
        Known {
            crc: blob::stored_crc(&bytes).unwrap(),
            answers: queries.iter().map(|query| host.command(query)).collect(),
            bytes,
        }
    });
    known.collect()
}

/// The models that may run after the next start, by what the device acknowledged: `old`, and `new` while it is being
/// stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stored {
    phase: Phase,
    old: u32,
    new: Option<u32>,
}

/// Uploads one model after the other until the device is gone, and reports when each phase begins. Returns what the device
/// had stored by then.
fn work(
    client: &mut Client,
    models: &[Known],
    first: u32,
    turn: usize,
    begins: &Sender<Phase>,
) -> Stored {
    let mut stored = Stored {
        phase: Phase::Upload,
        old: first,
        new: None,
    };
    for turn in turn.. {
        let others: Vec<&Known> = models
            .iter()
            .filter(|model| model.crc != stored.old)
            .collect();
        match one_round(client, others[turn % others.len()], &mut stored, begins) {
            Ok(()) => {}
            Err(ClientError::Lost { .. }) => break,
            Err(error) => panic!("{stored:?}: {error}"),
        }
    }
    stored
}

fn one_round(
    client: &mut Client,
    model: &Known,
    stored: &mut Stored,
    begins: &Sender<Phase>,
) -> Result<(), ClientError> {
    let begin = |phase: Phase, stored: &mut Stored, new: Option<u32>| {
        (stored.phase, stored.new) = (phase, new);
        // After the kill nobody receives this any more.
        let _ = begins.send(phase);
    };
    let before = stored.old;
    begin(Phase::Upload, stored, None);
    client.upload(&model.bytes, &mut |_| ())?;
    begin(Phase::Commit, stored, Some(model.crc));
    client.commit_upload()?;
    stored.old = model.crc;
    begin(Phase::Activate, stored, None);
    client.activate(model.crc)?;
    begin(Phase::RollBack, stored, Some(before));
    let identity = client.roll_back(model.crc)?;
    assert_eq!(identity.model.map(|model| model.blob_crc), Some(before));
    (stored.old, stored.new) = (before, None);
    Ok(())
}

fn start(memory: &Path) -> Device {
    let board = Board::default();
    let machine = Machine {
        board,
        elf: &firmware().unwrap_or_else(|error| panic!("{error}")).elf,
        clock: Clock::Real,
        flash_image: Some(memory),
    };
    Device::on(&machine).unwrap()
}

/// Returns the CRC of the running model, after its answers were checked.
fn running(device: &mut Device, models: &[Known], queries: &[Query]) -> u32 {
    let crc = device
        .identify()
        .unwrap()
        .model
        .expect("a model runs")
        .blob_crc;
    let model = models.iter().find(|model| model.crc == crc).unwrap();
    for (query, expected) in queries.iter().zip(&model.answers) {
        let answer = device.correct(query).unwrap();
        assert_eq!(answer.blob_crc, crc);
        assert_eq!(CommandBits::from(&answer), *expected);
    }
    crc
}

/// Kills of one phase, and what ran after the start: `old`, acknowledged last, or `new`, which was being stored.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    kills: usize,
    old: usize,
    new: usize,
}

#[test]
fn two_hundred_kills_lose_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let memory = folder.path().join("flash.bin");
    let queries = Sample::plain(93, SampleCorrection::None).queries(3);
    let models = models(&queries);
    let mut generator = ChaCha8Rng::seed_from_u64(94);
    let mut device = start(&memory);
    device.allow_any_time().unwrap();
    for model in &models[..2] {
        device.load(&model.bytes).unwrap();
    }
    let mut first = models[1].crc;
    // The longest time of each phase so far.
    let mut lengths = [Duration::from_millis(5); PHASES.len()];
    let mut tallies = [Tally::default(); PHASES.len()];
    for kill in 0..KILLS {
        let phase = MOMENTS[kill % MOMENTS.len()];
        let share = generator.random_range(0.0..1.1);
        let (emulator, mut client) = device.into_parts();
        let stored = thread::scope(|scope| {
            let (begins, begun) = mpsc::channel();
            let models = &models;
            let worker = scope.spawn(move || work(&mut client, models, first, kill, &begins));
            // Waits for the phase, then for a share of its length.
            let mut now = begun.recv().unwrap();
            let mut since = Instant::now();
            while now != phase {
                let next = begun.recv().unwrap();
                lengths[now as usize] = since.elapsed();
                (now, since) = (next, Instant::now());
            }
            let left = lengths[phase as usize].mul_f64(share);
            // The time has passed, or the phase has ended before.
            match begun.recv_timeout(left) {
                Ok(_) => lengths[phase as usize] = since.elapsed(),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => panic!("the workstation has stopped"),
            }
            drop(emulator);
            worker.join().unwrap()
        });
        device = start(&memory);
        let runs = running(&mut device, &models, &queries);
        let tally = &mut tallies[stored.phase as usize];
        tally.kills += 1;
        if runs == stored.old {
            tally.old += 1;
        } else {
            assert_eq!(Some(runs), stored.new, "{stored:?} after kill {kill}");
            tally.new += 1;
        }
        let statistics = device.statistics().unwrap();
        assert_eq!(
            statistics.restarts, 0,
            "a power cut must not count as a restart"
        );
        first = runs;
    }
    println!("{KILLS} kills with the flash in a file; what ran after the start:");
    for (phase, tally) in PHASES.iter().zip(&tallies) {
        println!(
            "  during {phase:?}: {} kills, {} old, {} new",
            tally.kills, tally.old, tally.new
        );
    }
    let sum = |of: fn(&Tally) -> usize| tallies.iter().map(of).sum::<usize>();
    println!(
        "  {} old, {} new, none lost",
        sum(|t| t.old),
        sum(|t| t.new)
    );
    assert_eq!(sum(|t| t.kills), KILLS);
    assert!(sum(|t| t.old) > 0 && sum(|t| t.new) > 0, "{tallies:?}");
    assert!(tallies.iter().all(|tally| tally.kills > 0), "{tallies:?}");
}
