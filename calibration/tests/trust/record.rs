//! Counts the cases of a run and writes its tables.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

/// Cases of one set.
#[derive(Default)]
pub struct Count {
    pub cases: usize,
    pub caught: usize,
    /// Cases that caused only a warning although the file should be refused.
    pub meek: usize,
    pub right: usize,
    /// Mistakes that nobody can see; they are not among the cases.
    pub unseen: usize,
    pub good: usize,
    pub false_alarms: usize,
}

impl Count {
    fn add(&mut self, other: &Self) {
        self.cases += other.cases;
        self.caught += other.caught;
        self.meek += other.meek;
        self.right += other.right;
        self.unseen += other.unseen;
        self.good += other.good;
        self.false_alarms += other.false_alarms;
    }
}

/// The results of a run.
#[derive(Default)]
pub struct Record {
    pub sets: BTreeMap<String, Count>,
    /// One text for each case that was missed, named wrongly, or a false alarm.
    pub misses: Vec<String>,
    /// Times of the examination on good sets of 300 rows, and on wrong files.
    pub good_times: Vec<Duration>,
    pub wrong_times: Vec<Duration>,
    pub not_run: Vec<String>,
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

/// Returns a count with its share of `whole`, or a dash if `whole` is zero.
fn share(part: usize, whole: usize) -> String {
    if whole == 0 {
        return "–".to_owned();
    }
    format!("{part} ({:.1} %)", percent(part, whole))
}

/// Returns the median and maximum in seconds.
fn times(times: &[Duration]) -> (f64, f64) {
    let mut seconds: Vec<f64> = times.iter().map(Duration::as_secs_f64).collect();
    seconds.sort_by(f64::total_cmp);
    let median = seconds.get(seconds.len() / 2).copied().unwrap_or(0.0);
    (median, seconds.last().copied().unwrap_or(0.0))
}

impl Record {
    pub fn of(&mut self, set: &str) -> &mut Count {
        self.sets.entry(set.to_owned()).or_default()
    }

    pub fn total(&self) -> Count {
        let mut total = Count::default();
        self.sets.values().for_each(|c| total.add(c));
        total
    }

    /// Returns the share of caught cases, and share of right causes among them, percent.
    pub fn shares(&self) -> (f64, f64) {
        let total = self.total();
        (
            percent(total.caught, total.cases),
            percent(total.right, total.caught),
        )
    }

    /// Returns the tables as Markdown.
    pub fn text(&self) -> String {
        let mut out = String::from(
            "| set | wrong files | caught | only warned | right cause | left out | good files | false alarms |\n|---|---|---|---|---|---|---|---|\n",
        );
        let total = self.total();
        let mut good_only = Count::default();
        let is_good_only = |c: &&Count| c.cases == 0;
        let merged = self.sets.values().filter(is_good_only);
        merged.clone().for_each(|c| good_only.add(c));
        let good_only_name = format!("{} sets of good files alone", merged.count());
        let sets = self.sets.iter().filter(|(_, c)| !is_good_only(c));
        let sets = sets.map(|(n, c)| (n.as_str(), c));
        for (name, c) in sets.chain([(&*good_only_name, &good_only), ("**all**", &total)]) {
            let _ = writeln!(
                out,
                "| {name} | {} | {} | {} | {} | {} | {} | {} |",
                c.cases,
                share(c.caught, c.cases),
                c.meek,
                share(c.right, c.caught),
                c.unseen,
                c.good,
                c.false_alarms
            );
        }
        for (what, list) in [
            ("good sets of 300 rows", &self.good_times),
            ("wrong files", &self.wrong_times),
        ] {
            let (median, most) = times(list);
            let _ = writeln!(
                out,
                "\nTime of the gate on {} {what}: median {median:.3} s, maximum {most:.3} s.",
                list.len()
            );
        }
        for name in &self.not_run {
            let _ = writeln!(out, "\nNOT RUN: {name}");
        }
        out
    }
}

/// The introduction of the record.
const HEAD: &str = "
```sh
POEGP_MEASURED_DATA=FOLDER POEGP_RECORD=docs/evidence/trust.md cargo test --release -p poegp-calibration --test trust -- \\
    --ignored --nocapture whole
```

Each set is written in about 155 wrong and twelve good ways, whole and as random rows.

- *Caught*: the program warns of a wrong file or refuses it. *Only warned*: it should have refused it.
- *Right cause*: the cause is among the gravest findings and names the joint.
- *Left out*: mistakes that base, tool or scatter hides.
- *False alarm*: a warning of a good file.

Simulated sets are named by robot and kind of errors; `measured` ones come from others. Times are wall-clock times beside other work.
`cargo test --release -p poegp-calibration --test speed` bounds CPU time: 0.3 s on good rows, 2 s where nothing explains the rows.

";

/// Writes the record with date and commit; keeps what follows the first heading "Added".
pub fn write(path: &std::path::Path, record: &Record, seed: u64) {
    let output = |program: &str, arguments: &[&str]| {
        let found = std::process::Command::new(program).args(arguments).output();
        let text = found.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
        text.unwrap_or_default()
    };
    let commit = std::env::var("POEGP_COMMIT")
        .unwrap_or_else(|_| output("git", &["rev-parse", "--short", "HEAD"]));
    let date = output("date", &["+%F"]);
    let mut text = format!(
        "# Wrong and good measurement files\n\nRecorded on {date} at commit {commit}, seed {seed}, by\n"
    );
    text += HEAD;
    text += &record.text();
    let _ = writeln!(
        text,
        "\n{} files were judged wrongly (the run prints its findings):\n\n```text",
        record.misses.len()
    );
    for miss in &record.misses {
        // Set, mistake and verdict.
        let parts: Vec<&str> = miss.split(" | ").take(3).collect();
        let _ = writeln!(text, "{}", parts.join(": "));
    }
    text += "```\n";
    // Sections that other runs have added stay.
    let before = std::fs::read_to_string(path).unwrap_or_default();
    let added = before.find("\n## Added").map_or("", |at| &before[at..]);
    text += added;
    std::fs::write(path, text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
}
