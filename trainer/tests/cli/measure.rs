//! `trainer measure`: rows one by one from a simulated arm, bad rows, interruptions and kills.

use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use poegp_calibration::measurement::touch::{Reading, TouchRow, TouchSet};
use poegp_calibration::robot::{LoadOptions, Robot};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::program::Folder;
use crate::texts::texts;

/// A simulated arm that answers each request with the nearest touch of the same feature.
struct Answers {
    set: TouchSet,
    header: String,
    lines: Vec<String>,
    used: Vec<bool>,
}

const MEASURE: &str = "measure --robot abb-irb120 plan.csv --features touched/touches.toml --out measured.csv --json -";

impl Answers {
    /// Simulates touches of two sockets and a wire in `touched`, and writes a plan of most of them to plan.csv.
    fn new(folder: &Folder) -> Self {
        folder
            .run("simulate --robot abb-irb120 --touch socket2,wire1 --touches 40 --seed 6 --out touched")
            .ok();
        let text = folder.text("touched/touches.csv");
        folder.write("plan.csv", &text);
        let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
        let set = TouchSet::read(&folder.path("touched/touches.csv"), None, &robot).unwrap();
        let lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let header = lines.iter().find(|line| line.contains("q1_deg"));
        Self {
            header: header.unwrap().clone(),
            lines: set.rows.iter().map(|r| lines[r.line - 1].clone()).collect(),
            used: vec![false; set.rows.len()],
            set,
        }
    }

    fn feature(&self, row: &TouchRow) -> String {
        match row.reading {
            Reading::Tracker(_) => String::new(),
            reading => self.set.features[reading.feature().unwrap()].name.clone(),
        }
    }

    /// Returns the line of the row that answers a request.
    fn to(&mut self, asked: &Value) -> String {
        let wanted: Vec<f64> = asked["joints"]
            .as_array()
            .unwrap()
            .iter()
            .map(|q| q.as_f64().unwrap())
            .collect();
        let free = (0..self.lines.len()).filter(|i| !self.used[*i]);
        let own =
            free.filter(|i| self.feature(&self.set.rows[*i]) == asked["feature"].as_str().unwrap());
        let apart = |i: &usize| -> f64 {
            let joints = self.set.rows[*i].joints.iter().zip(&wanted);
            joints.map(|(q, w)| (q.to_degrees() - w).powi(2)).sum()
        };
        let best = own.min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap();
        self.used[best] = true;
        self.lines[best].clone()
    }
}

pub struct Session {
    pub child: Child,
    to: Option<ChildStdin>,
    from: BufReader<ChildStdout>,
}

impl Session {
    pub fn begin(folder: &Folder, line: &str) -> Self {
        let mut command: Command = folder.command(line);
        let command = command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.stderr(Stdio::null()).spawn().unwrap();
        Self {
            to: child.stdin.take(),
            from: BufReader::new(child.stdout.take().unwrap()),
            child,
        }
    }

    /// Returns the next JSON document; `None` at the end.
    pub fn next(&mut self) -> Option<Value> {
        let mut line = String::new();
        match self.from.read_line(&mut line) {
            Ok(count) if count > 0 && line.ends_with('\n') => {
                Some(serde_json::from_str(&line).unwrap())
            }
            _ => None,
        }
    }

    pub fn say(&mut self, line: &str) -> bool {
        let to = self.to.as_mut().unwrap();
        to.write_all(format!("{line}\n").as_bytes())
            .and_then(|()| to.flush())
            .is_ok()
    }

    pub fn code(mut self) -> Option<i32> {
        self.to = None;
        self.child.wait().unwrap().code()
    }
}

/// An arm answers until its expected error is small enough. `calibrate` accepts the file and states the same expected error.
#[test]
fn rows_are_asked_for_until_the_error_is_small_enough() {
    let folder = Folder::new();
    let mut arm = Answers::new(&folder);
    let mut session = Session::begin(&folder, &format!("{MEASURE} --until-mm 0.2"));
    let (mut expected, mut end, mut said) = (Vec::new(), None, Vec::new());
    while let Some(document) = session.next() {
        match document["event"].as_str().unwrap() {
            "next" => {
                let line = arm.to(&document);
                said.push(line.clone());
                assert!(session.say(&line));
            }
            "estimate" => expected.extend(document["expected_mm"].as_f64()),
            "end" => end = Some(document),
            _ => {}
        }
    }
    assert_eq!(session.code(), Some(0));
    let end = end.unwrap();
    assert_eq!(end["reason"], "reached");
    assert!(expected.len() > 10 && expected[0] > 0.2, "{expected:?}");
    let last = *expected.last().unwrap();
    assert!(last <= 0.2, "{expected:?}");
    assert!(
        said.len() < arm.lines.len(),
        "the session must end before the plan"
    );
    let text = folder.text("measured.csv");
    let rows: Vec<&str> = text.lines().skip(1).collect();
    assert_eq!(
        rows, said,
        "the file has the rows of the session, byte by byte"
    );
    folder
        .run("calibrate --robot abb-irb120 measured.csv --features touched/touches.toml --out m.blob --json m.json")
        .ok();
    let found: Value = serde_json::from_slice(&folder.read("m.json")).unwrap();
    let after = found["touches"]["after"]["mean_mm"].as_f64().unwrap();
    assert!((after / last - 1.0).abs() < 0.15, "{after} {last}");
}

/// A row that cannot be used is refused with its reason and asked for again. A row far off is kept with a warning.
#[test]
fn bad_rows_change_nothing_and_outliers_are_reported() {
    let _texts = texts();
    let folder = Folder::new();
    let arm = Answers::new(&folder);
    let header = &arm.header;
    let good: Vec<&str> = arm.lines.iter().map(String::as_str).step_by(3).collect();
    let row = &arm.set.rows[0];
    let mut far: Vec<String> = arm.lines[1].split(',').map(str::to_owned).collect();
    let at = header.split(',').position(|name| name == "q2_deg").unwrap();
    far[at] = format!("{:.4}", row.joints[1].to_degrees() + 4.0);
    let missing = arm.lines[0].rsplit_once(',').unwrap().0;
    let input = format!(
        "{header}\n\n# a remark\n{}\nhole,1,2,3\n#N/A,12,3\n{missing}\n{}\n{}\nskip\n",
        good.join("\n"),
        arm.lines[0].replace("socket/0", "hole"),
        far.join(",")
    );
    let line = MEASURE.replace("--json -", "--json rows.json --until-mm 0.01");
    let outcome = folder.run_with_input(&line, &input);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(
        outcome.stderr.contains("from what the other rows predict"),
        "{outcome:#?}"
    );
    crate::texts::record(&outcome.line, &crate::texts::masked(&outcome.stderr, true));
    let documents: Vec<Value> = folder
        .text("rows.json")
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let events = |name: &str| documents.iter().filter(|d| d["event"] == name).count();
    assert_eq!(events("refused"), 4);
    assert_eq!(events("accepted"), good.len() + 1);
    let text = folder.text("measured.csv");
    let rows = text.lines().filter(|line| !line.starts_with('#')).count() - 1;
    assert_eq!(rows, good.len() + 1, "the outlier is kept");
    // Other columns than those of the file.
    let outcome = folder.run_with_input(&line, "feature,q1_deg\n");
    assert!(outcome.stderr.contains("other columns"), "{outcome:#?}");
    folder.refuses("measure --robot abb-irb120 nowhere.csv --out m.csv");
    folder.refuses(
        "measure --robot abb-irb120 plan.csv --features touched/touches.toml --out plan.csv",
    );
    folder.refuses("measure --robot abb-irb120 plan.csv --out m.csv");
    folder.refuses(
        "measure --robot abb-irb120 plan.csv --features touched/touches.toml --positions --out m.csv",
    );
    folder.refuses("measure --robot abb-irb120 plan.csv --features touched/touches.toml --out m.csv --from unix:nowhere");
}

/// `undo` takes a row back, a skipped row stays skipped, bytes that are not text end nothing, and a wrong header can be
/// corrected. A second session with the same source repeats none of that.
#[test]
fn answers_are_taken_back_and_never_repeated() {
    let folder = Folder::new();
    let arm = Answers::new(&folder);
    let header = &arm.header;
    let mut log = format!("feature,q1_deg\n{header}\n").into_bytes();
    // The first `undo` comes before any row: it stays refused when there is one.
    log.extend(b"# gr\xfcn\nskip\nundo 1\n");
    log.extend(format!("{}\n{}\nundo 1\n", arm.lines[0], arm.lines[1]).bytes());
    log.extend(b"\xff\n");
    folder.write("log.csv", &log);
    let line = format!("{MEASURE} --from log.csv");
    let mut skipped = None;
    // The second session knows the columns, so it refuses the first two header lines differently: the wrong one as well.
    for (refused, taken, taken_back) in [(2, 2, 1), (2, 0, 0)] {
        let mut running = Session::begin(&folder, &line);
        let mut documents: Vec<Value> = Vec::new();
        let count = |of: &[Value], name: &str| of.iter().filter(|d| d["event"] == name).count();
        while count(&documents, "refused") < refused {
            documents.push(running.next().unwrap());
        }
        assert_eq!(count(&documents, "accepted"), taken, "{documents:?}");
        assert_eq!(count(&documents, "withdrawn"), taken_back);
        let mut asked = documents.iter().filter(|d| d["event"] == "next");
        if skipped.is_none() {
            skipped = asked.next().map(|d| d["line"].clone());
        }
        assert!(asked.all(|d| Some(&d["line"]) != skipped.as_ref()));
        running.child.kill().unwrap();
        running.code();
        let text = folder.text("measured.csv");
        let rows: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
        assert_eq!(rows, [header, &arm.lines[1]], "{text}");
    }
}

/// What follows a word that ends is not read.
#[test]
fn a_word_ends_the_measurement_and_an_unknown_one_is_named() {
    let folder = Folder::new();
    let arm = Answers::new(&folder);
    let header = &arm.header;
    let line = MEASURE.replace("--json -", "--json log.json");
    let [first, second] = [&arm.lines[0], &arm.lines[1]];
    let input = format!("{header}\nskp\n{first}\nUNDO\n{first}\nQuit\n{second}\n");
    let outcome = folder.run_with_input(&line, &input);
    let said = format!("{}{}", outcome.stdout, outcome.stderr);
    assert!(
        said.contains("the word \"skp\", expected a row, or one of skip, undo"),
        "{outcome:#?}"
    );
    let text = folder.text("measured.csv");
    let rows: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
    assert_eq!(rows, [header, first], "{text}");
}

/// A small expected error is not enough while a feature has too few rows, and the end says so.
#[test]
fn a_feature_without_rows_is_named_at_the_end() {
    let folder = Folder::new();
    let arm = Answers::new(&folder);
    let header = &arm.header;
    let sockets = arm.lines.iter().filter(|line| line.starts_with("socket"));
    let sockets: Vec<&str> = sockets.map(String::as_str).collect();
    let line = format!("{MEASURE} --until-mm 50").replace("--json -", "--json log.json");
    let outcome = folder.run_with_input(&line, &format!("{header}\n{}\n", sockets.join("\n")));
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let has = |text: &str| outcome.stderr.contains(text);
    assert!(
        has("50 mm, but") && has("which `calibrate` needs"),
        "{outcome:#?}"
    );
}

/// Kills the program at a random moment, `kills` times; the last run may end. Returns the number of confirmed rows.
fn killed(kills: usize, seed: u64) -> usize {
    let folder = Folder::new();
    let mut arm = Answers::new(&folder);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut confirmed: Vec<String> = Vec::new();
    let (mut all, mut torn) = (0, 0);
    for kill in 0..=kills {
        if confirmed.len() + 20 > arm.lines.len() {
            // A new measurement, because the rows are used up.
            std::fs::remove_file(folder.path("measured.csv")).unwrap();
            arm.used.iter_mut().for_each(|used| *used = false);
            confirmed.clear();
        }
        let mut session = Session::begin(&folder, MEASURE);
        let process = session.child.id();
        let is_last = kill == kills;
        let wait = std::time::Duration::from_micros(random.random_range(0..250_000));
        let killer = move || {
            std::thread::spawn(move || {
                std::thread::sleep(wait);
                let status = Command::new("kill")
                    .args(["-KILL", &process.to_string()])
                    .status();
                assert!(status.unwrap().success());
            })
        };
        // A third of the kills come at the start, the others while the program asks or takes.
        let mut killing = (!is_last && kill % 3 == 0).then(killer);
        let mut waiting = None;
        let mut answered = 0;
        while let Some(document) = session.next() {
            if !is_last && killing.is_none() {
                killing = Some(killer());
            }
            match document["event"].as_str().unwrap() {
                "next" if is_last && answered == 3 => break,
                "next" => {
                    let line = arm.to(&document);
                    answered += 1;
                    waiting = Some(line.clone());
                    if !session.say(&line) {
                        break;
                    }
                }
                "accepted" => {
                    confirmed.extend(waiting.take());
                    all += 1;
                }
                _ => {}
            }
        }
        if let Some(killing) = killing {
            killing.join().unwrap();
        }
        session.code();
        let text =
            String::from_utf8(std::fs::read(folder.path("measured.csv")).unwrap_or_default())
                .unwrap();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        torn += usize::from(whole.len() + 1 < text.len());
        let rows: Vec<&str> = whole
            .lines()
            .filter(|l| !l.starts_with('#'))
            .skip(1)
            .collect();
        // Every confirmed row is there, in order, and at most one row that was in progress.
        assert!(
            rows.len() >= confirmed.len(),
            "kill {kill}: {rows:?} {confirmed:?}"
        );
        assert!(
            rows.iter().zip(&confirmed).all(|(a, b)| a == b),
            "kill {kill}"
        );
        assert!(rows.len() <= confirmed.len() + 1, "kill {kill}");
        if let Some(more) = rows.get(confirmed.len()) {
            assert_eq!(Some(*more), waiting.as_deref(), "kill {kill}");
            confirmed.push((*more).to_owned());
        } else if let Some(lost) = waiting {
            let at = arm.lines.iter().position(|line| *line == lost).unwrap();
            arm.used[at] = false;
        }
    }
    println!("{kills} kills, {all} rows confirmed, {torn} torn lines");
    all
}

#[test]
fn nothing_that_was_confirmed_is_lost_by_a_kill() {
    assert!(killed(30, 1) >= 10);
}

/// Run it with: cargo test --release -p poegp-trainer --test cli -- measure::a_thousand_kills --ignored --nocapture
#[test]
#[ignore = "ten minutes"]
fn a_thousand_kills_lose_nothing() {
    assert!(killed(1000, 2) >= 300);
}

/// A power cut tore the last line: it is reported and becomes a comment, all other lines stay, and the session continues.
#[test]
fn a_torn_line_is_reported_and_kept_as_a_comment() {
    let folder = Folder::new();
    let arm = Answers::new(&folder);
    let input = arm.lines[..6].join("\n") + "\n";
    folder.run_with_input(MEASURE, &input);
    let whole = folder.text("measured.csv");
    assert_eq!(whole.lines().count(), 7);
    for cut in [1, 5, 20] {
        folder.write("measured.csv", &whole[..whole.len() - cut]);
        let outcome = folder.run_with_input(MEASURE, &format!("{}\n", arm.lines[5]));
        assert!(
            outcome.stderr.contains("incomplete and is now a comment"),
            "{outcome:#?}"
        );
        assert!(
            outcome.stderr.contains("Continuing with 5 rows"),
            "{outcome:#?}"
        );
        let text = folder.text("measured.csv");
        assert_eq!(
            text.lines().filter(|l| l.starts_with('#')).count(),
            1,
            "{text}"
        );
        let rows: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
        assert_eq!(rows, whole.lines().collect::<Vec<_>>());
    }
}

/// Another program appends to a watched file, sometimes half lines: each row is taken once, also in a second session.
#[test]
fn a_file_is_watched() {
    let folder = Folder::new();
    let arm = Answers::new(&folder);
    folder.write("log.csv", "");
    let line = format!("{MEASURE} --from log.csv");
    let log: PathBuf = folder.path("log.csv");
    let append = |text: &str| {
        let mut file = std::fs::OpenOptions::new().append(true).open(&log).unwrap();
        file.write_all(text.as_bytes()).unwrap();
    };
    let mut rows = 0;
    for (session, half) in [(0, 9), (1, 1)] {
        let mut running = Session::begin(&folder, &line);
        for i in 0..3 {
            while running.next().unwrap()["event"] != "next" {}
            let (first, second) = arm.lines[3 * session + i].split_at(half);
            append(first);
            std::thread::sleep(std::time::Duration::from_millis(120));
            append(&format!("{second}\n"));
            let document = running.next().unwrap();
            assert_eq!(document["event"], "accepted");
            rows += 1;
            assert_eq!(document["row"], rows);
        }
        running.child.kill().unwrap();
        running.code();
    }
    let text = folder.text("measured.csv");
    assert_eq!(text.lines().skip(1).collect::<Vec<_>>(), &arm.lines[..6]);
}

/// With a tracker's plan, the result is a measurement file.
#[test]
fn poses_of_a_tracker_are_measured_too() {
    let folder = Folder::new();
    folder
        .run("simulate --robot abb-irb120 --poses 40 --test-sets 0 --payloads 2 --seed 3 --out s")
        .ok();
    folder.write("plan.csv", folder.text("s/train.csv"));
    let set = poegp_calibration::measurement::read(folder.path("s/train.csv")).unwrap();
    let text = folder.text("s/train.csv");
    let lines: Vec<&str> = text.lines().collect();
    let mut session = Session::begin(
        &folder,
        "measure --robot abb-irb120 plan.csv --out m.csv --json - --until-mm 0.12",
    );
    let mut last = None;
    while let Some(document) = session.next() {
        if document["event"] == "next" {
            let line = document["line"].as_u64().unwrap() as usize;
            assert!(set.measurements.iter().any(|m| m.line == line));
            assert!(session.say(lines[line - 1]));
        }
        last = Some(document);
    }
    let last = last.unwrap();
    assert_eq!(
        (session.code(), &last["reason"]),
        (Some(0), &Value::from("reached")),
        "{last}"
    );
    assert!(last["rows"].as_u64().unwrap() < 40, "{last}");
    folder
        .run("calibrate --robot abb-irb120 m.csv --method elastic --accept few --out m.blob")
        .ok();
}
