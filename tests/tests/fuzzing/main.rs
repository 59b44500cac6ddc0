//! Every reader of input with mutated inputs, which are seeded and the same in each run; and with every input that the
//! fuzzer kept or that once broke a law.
//!
//! `POEGP_FUZZ=1000000 cargo test --release -p poegp-tests --test fuzzing -- --nocapture` sets the number of executions of
//! each target, and `POEGP_FUZZ_SEED` selects other inputs. `tests/fuzz/run` lets libFuzzer search for inputs that reach
//! new code; docs/evidence/verification-evidence.md has the record of a long run.

use std::env;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};

use poegp_tests::fuzzing::kept::{self, Kept};
use poegp_tests::fuzzing::{TARGETS, Target, mutate};
use poegp_tests::workspace;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Returns the number in an environment variable, or `otherwise`.
fn asked(variable: &str, otherwise: u64) -> u64 {
    env::var(variable).map_or(otherwise, |text| {
        text.parse()
            .unwrap_or_else(|_| panic!("{variable} is {text:?}; a number is expected"))
    })
}

/// Returns the kept inputs of a target, with their places.
fn kept_inputs(which: Kept, target: &Target) -> Vec<(String, Vec<u8>)> {
    let inputs = kept::read(which, target.name).unwrap_or_else(|error| panic!("{error}"));
    let name = |number| format!("line {number} of its {which:?}");
    (1..).map(name).zip(inputs).collect()
}

fn fuzz(name: &str) {
    let target = TARGETS.iter().find(|target| target.name == name);
    let target = target.expect("a row of the table");
    let executions = asked("POEGP_FUZZ", target.executions);
    let seed = asked("POEGP_FUZZ_SEED", 7);
    let seeds = (target.seeds)();
    let mut random = ChaCha8Rng::seed_from_u64(seed);

    let mut inputs: Vec<_> = (0..)
        .zip(seeds.clone())
        .map(|(number, bytes)| (format!("seed {number}"), bytes))
        .collect();
    let own = inputs.len();
    inputs.extend(kept_inputs(Kept::Regressions, target));
    inputs.extend(kept_inputs(Kept::Corpus, target));
    let mutated = (0..executions).map(|number| {
        let bytes = mutate::mutated(&seeds, &mut random);
        (format!("number {number} of seed {seed}"), bytes)
    });
    let kept = inputs.len() - own;
    for (which, bytes) in inputs.into_iter().chain(mutated) {
        if catch_unwind(AssertUnwindSafe(|| (target.run)(&bytes))).is_err() {
            let place = env::temp_dir().join(format!("poegp-fuzz-{name}"));
            fs::write(&place, &bytes).unwrap();
            panic!(
                "{name}: {which} breaks a law; the input is in {}",
                place.display()
            );
        }
    }
    println!("{name}: {own} valid inputs, {kept} kept, {executions} made from seed {seed}");
}

/// A test for each row of the table, so that they run in parallel and none is forgotten.
macro_rules! targets {
    ($($name:ident)*) => {
        $(
            #[test]
            fn $name() {
                fuzz(stringify!($name));
            }
        )*

        #[test]
        fn every_target_has_a_test_and_a_program() {
            let tests = [$(stringify!($name)),*];
            let rows = TARGETS.map(|target| target.name);
            assert_eq!(rows[..], tests);
            let manifest = fs::read_to_string(workspace().join("fuzz/Cargo.toml")).unwrap();
            for name in tests {
                assert!(manifest.contains(&format!("name = \"{name}\"")), "{name}");
            }
        }
    };
}

targets! {
    blob envelope frame service measurements targets import preset urdf toml cell touches
    rapid urscript fanuc krl inform val3 table rsi report
}

/// Seeds are accepted by their readers (of robots, more than half); otherwise all mutated inputs would be noise. Raw files
/// and names may be anything.
#[test]
fn valid_inputs_are_valid() {
    use poegp_calibration::blob::predict::BlobModel;
    use poegp_calibration::robot::{LoadOptions, Robot};
    use poegp_trainer::import::column_map::Map;
    use std::path::Path;

    let seeds = poegp_tests::fuzzing::seeds::blobs();
    assert!(
        seeds
            .into_iter()
            .all(|bytes| BlobModel::from_bytes(bytes).is_ok())
    );
    for (name, seeds) in [
        ("arm.urdf", poegp_tests::fuzzing::seeds::urdfs()),
        ("arm.toml", poegp_tests::fuzzing::seeds::tomls()),
    ] {
        let options = LoadOptions::default();
        let is_robot = |bytes: &&Vec<u8>| Robot::parse(Path::new(name), bytes, &options).is_ok();
        let taken = seeds.iter().filter(is_robot).count();
        assert!(
            2 * taken > seeds.len(),
            "{name}: {taken} of {}",
            seeds.len()
        );
    }
    for bytes in poegp_tests::fuzzing::seeds::touches() {
        use poegp_calibration::measurement::touch::TouchSet;
        let mut parts = bytes.splitn(2, |byte| *byte == 0);
        let mut file = |name| (Path::new(name), parts.next().unwrap());
        let (features, rows) = (file("touches.toml"), file("touches.csv"));
        let robot = poegp_tests::fuzzing::readers::six_axes();
        let taken = TouchSet::parse(rows, features, &robot);
        assert!(taken.is_ok(), "{:?}", taken.err());
    }
    for bytes in poegp_tests::fuzzing::seeds::rsi() {
        use poegp_trainer::bridge::message::{Setpoint, read};
        let packets = bytes.strip_suffix(b"\0").unwrap().split(|byte| *byte == 0);
        assert!(
            packets
                .into_iter()
                .all(|packet| read(packet, Setpoint::Commanded).is_some())
        );
    }
    for bytes in poegp_tests::fuzzing::seeds::imports() {
        let map = bytes.split(|byte| *byte == 0).next().unwrap();
        let map = Map::parse(Path::new("map.toml"), std::str::from_utf8(map).unwrap());
        assert!(map.is_ok(), "{:?}", map.err());
    }
}
