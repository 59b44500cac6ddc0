//! Tests the examination of measurements on a corpus of files with mistakes, and on good files.
//!
//! ```sh
//! cargo test --release -p poegp-calibration --test trust -- --ignored --nocapture whole
//! ```
//!
//! Environment variables: `POEGP_TRUST_SET` and `POEGP_TRUST_MISTAKE` run only the sets and mistakes whose names contain a
//! text (`good` selects the good files). `POEGP_SEED` draws other mistakes. `POEGP_MEASURED_DATA` names the folder of the
//! measured sets, and `POEGP_RECORD` a file for the record.

mod good;
mod hidden;
mod honest;
mod judge;
mod mistakes;
mod record;
mod set_ups;
mod sets;
mod table;

use std::fmt::Display;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Write;

use poegp_calibration::robot::BUILT_IN;
use poegp_calibration::trust::Tier;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::judge::{Answer, Changed, ask};
use crate::mistakes::GRAVITY;
use crate::record::Record;
use crate::sets::Good;

/// Most rows of a file with a mistake.
const ROWS: usize = 300;

/// Prints a line, even when the test harness captures output.
fn say(text: impl Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

fn filter(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

/// Returns a random generator for each case, so that filtering does not change what other cases draw.
fn random(seed: u64, names: &[&str]) -> ChaCha8Rng {
    let mut hasher = DefaultHasher::new();
    (seed, names).hash(&mut hasher);
    ChaCha8Rng::seed_from_u64(hasher.finish())
}

fn seed() -> u64 {
    filter("POEGP_SEED").parse().unwrap_or(17)
}

/// A run over sets, with its filters.
struct Run {
    seed: u64,
    set: String,
    mistake: String,
    /// One of this many mistakes of a set is run; seed and set decide which.
    stride: usize,
    record: Record,
}

impl Run {
    fn new(stride: usize) -> Self {
        Self {
            seed: seed(),
            set: filter("POEGP_TRUST_SET"),
            mistake: filter("POEGP_TRUST_MISTAKE"),
            stride,
            record: Record::default(),
        }
    }

    fn takes(&self, set: &str) -> bool {
        set.contains(&self.set)
    }

    /// Runs the mistakes of a set.
    fn wrong(&mut self, good: &Good, seed: u64) {
        if !self.takes(&good.name) {
            return;
        }
        let mut draw = random(self.seed + seed, &[&good.name]);
        let good = good::subset(good, ROWS, &mut draw);
        let right_text = good.text(&good.table);
        let left_mm = hidden::left_mm(&good.robot, &right_text).expect("a good set");
        let mut all = mistakes::all(&good);
        all.retain(|m| m.name.contains(&self.mistake));
        let taken = mistakes::some(all.len(), all.len().div_ceil(self.stride), &mut draw);
        for mistake in taken.iter().map(|i| &all[*i]) {
            let mut draw = random(self.seed + seed, &[&good.name, &mistake.name]);
            let table = mistake.table(&good, &mut draw);
            let text = good.text(&table);
            let robot = mistake.robot.as_ref().unwrap_or(&good.robot);
            let changed = Changed::between(&right_text, &text, mistake.robot.is_some());
            let answer = ask(robot, &text, mistake.gravity);
            if let Some(reason) = hidden::reason(&good, left_mm, mistake, &table) {
                self.record.of(&good.name).unseen += 1;
                let verdict = format!("left out: {reason}");
                self.report(&good.name, &mistake.name, &verdict, &answer, true);
                continue;
            }
            let caught = answer.is_caught(&good.exempt);
            let named = answer.names(&mistake.joints);
            let right = caught && named && answer.is_right(&mistake.right, &changed);
            let count = self.record.of(&good.name);
            count.cases += 1;
            count.caught += usize::from(caught);
            let meek = caught && !mistake.only_warns && !answer.is_refused();
            count.meek += usize::from(meek);
            count.right += usize::from(right);
            let verdict = match (caught, right) {
                (false, _) => "MISSED",
                (true, false) if !named => "WRONG JOINT OR CAUSE",
                (true, false) => "WRONG CAUSE",
                (true, true) if meek => "right, NOT REFUSED",
                (true, true) => "right",
            };
            self.record.wrong_times.extend(answer.time());
            self.report(&good.name, &mistake.name, verdict, &answer, right && !meek);
        }
    }

    /// Runs one good file.
    fn good(&mut self, good: &Good, name: &str, text: &str) {
        let name = format!("good: {name}");
        if !self.takes(&good.name) || !name.contains(&self.mistake) {
            return;
        }
        let answer = ask(&good.robot, text, GRAVITY);
        let is_alarm = answer.is_caught(&good.exempt) || matches!(answer, Answer::Panicked);
        let count = self.record.of(&good.name);
        count.good += 1;
        count.false_alarms += usize::from(is_alarm);
        if text.lines().count() == ROWS + 1 {
            self.record.good_times.extend(answer.time());
        }
        let verdict = if is_alarm { "FALSE ALARM" } else { "silent" };
        self.report(&good.name, &name, verdict, &answer, !is_alarm);
    }

    /// Runs all variants of a good set, and random subsets.
    fn good_variants(&mut self, good: &Good, seeds: usize) {
        for (name, make) in good::VARIANTS {
            let mut draw = random(self.seed, &[&good.name, name]);
            self.good(good, name, &good.text(&make(good, &mut draw)));
        }
        for rows in good::SIZES.into_iter().filter(|r| *r < good.table.len()) {
            for seed in 0..seeds {
                let (way, make) = good::VARIANTS[seed % good::VARIANTS.len()];
                let name = format!("{rows} rows, draw {seed}, {way}");
                let mut draw = random(self.seed, &[&good.name, &name]);
                let part = good::subset(good, rows, &mut draw);
                let table = make(&part, &mut draw);
                self.good(good, &name, &part.text(&table));
            }
        }
    }

    fn report(&mut self, set: &str, case: &str, verdict: &str, answer: &Answer, is_fine: bool) {
        let time = answer.time().map_or(0.0, |t| t.as_secs_f64());
        let line = format!(
            "{set} | {case} | {verdict} | {} | {time:.2} s",
            answer.summary()
        );
        say(&line);
        if is_fine {
            return;
        }
        let mut miss = line;
        for text in answer.texts() {
            miss += &format!("\n    {text}");
        }
        self.record.misses.push(miss);
    }

    /// Prints the tables and writes the record.
    fn finish(&self) {
        say(format_args!(
            "\n{} cases that are not as they should be:",
            self.record.misses.len()
        ));
        for miss in &self.record.misses {
            say(miss);
        }
        let text = self.record.text();
        say(format_args!("\n{text}"));
        if let Some(path) = std::env::var_os("POEGP_RECORD") {
            record::write(path.as_ref(), &self.record, self.seed);
        }
    }
}

/// Returns all sets for mistakes: simulated sets, the same reduced to one reflector, and measured sets.
fn sets_with_mistakes() -> (Vec<Good>, Vec<String>) {
    let mut sets = sets::simulated_files();
    sets.push(sets[0].clone().with_positions_only());
    sets.push(sets[2].clone().with_positions_only());
    for (robot, scenario) in [
        ("abb-irb120", 0),
        ("abb-irb4400", 2),
        ("kuka-iiwa7", 1),
        ("ur10", 1),
        ("ur5", 2),
    ] {
        sets.push(sets::simulated(robot, scenario, 3, ROWS));
    }
    let (measured, mut missing) = sets::measured();
    for (name, scenario) in [("franka_panda.urdf", 1), ("kuka_lbr_iiwa14.urdf", 2)] {
        match sets::model(name) {
            Some(spec) => sets.push(sets::simulated(&spec, scenario, 3, ROWS)),
            None => missing.push(name.to_owned()),
        }
    }
    let ur10 = measured.iter().find(|s| s.name.contains("ur10"));
    let positions = ur10.map(|s| s.clone().with_positions_only());
    sets.extend(measured.iter().cloned());
    sets.extend(positions);
    (sets, missing)
}

#[test]
#[ignore = "long; its command is in the head of this file"]
fn whole() {
    let mut run = Run::new(1);
    let (sets, missing) = sets_with_mistakes();
    for set in &sets {
        run.good_variants(set, 20);
        run.wrong(set, 0);
    }
    let mixed = sets::description("mixed.urdf");
    for robot in BUILT_IN.iter().copied().chain([mixed.as_str()]) {
        for scenario in 0..4 {
            let name = sets::simulated(robot, scenario, 0, 1).name;
            if !run.takes(&name) {
                continue;
            }
            for seed in 0..20 {
                for rows in good::SIZES {
                    let good = sets::simulated(robot, scenario, 100 + seed, rows);
                    let text = good.text(&good.table);
                    run.good(&good, &format!("{rows} rows of arm {seed}"), &text);
                }
            }
        }
    }
    run.record.not_run = missing;
    run.finish();
}

#[test]
fn sample() {
    let mut run = Run::new(15);
    let (sets, missing) = sets_with_mistakes();
    for set in &sets {
        run.wrong(set, 0);
        let mut draw = random(run.seed, &[&set.name, "sample"]);
        let part = good::subset(set, 100, &mut draw);
        run.good(&part, "100 rows", &part.text(&part.table));
    }
    run.record.not_run = missing;
    run.finish();
    let (caught, right) = run.record.shares();
    assert!(caught >= 98.0, "only {caught:.1} % caught");
    assert!(right >= 95.0, "only {right:.1} % with the right cause");
    assert_eq!(run.record.total().false_alarms, 0);
}

/// A table writes what it read. Every mistake changes either the file, or the robot or the gravity that is stated for it.
#[test]
fn every_mistake_changes_the_file_or_the_robot() {
    for good in [
        &sets::simulated_files()[0],
        &sets::simulated("kuka-iiwa7", 0, 1, 60),
    ] {
        assert!(sets::read(&good.robot, &good.text(&good.table)).is_ok());
        for mistake in mistakes::all(good) {
            let mut draw = random(1, &[&good.name, &mistake.name]);
            let table = mistake.table(good, &mut draw);
            let same = table.text() == good.table.text();
            let elsewhere = mistake.robot.is_some() || mistake.gravity != GRAVITY;
            assert_eq!(same, elsewhere, "{}", mistake.name);
        }
    }
}

/// Every cause has a mistake in the corpus, except the causes that the fit finds.
#[test]
fn every_cause_has_a_mistake() {
    use poegp_calibration::trust::Cause;
    // Causes of the fit, not of the file.
    let others = [Cause::Still, Cause::Time, Cause::Model, Cause::Gain];
    let good = &sets::simulated_files()[0];
    let all = mistakes::all(good);
    for cause in Cause::ALL.iter().filter(|c| !others.contains(c)) {
        assert!(all.iter().any(|m| m.right.contains(cause)), "{cause}");
    }
    assert!(Tier::Warning > Tier::Note);
}
