//! `trainer measure`: which rows count, and where they are.

use serde_json::Value;

use crate::measure::Session;
use crate::program::{Folder, Outcome, changed};

const MEASURE: &str = "measure --robot abb-irb120 plan.csv --out m.csv";

/// A folder with a plan of a tracker; returns the header and the measured rows of its poses, too.
fn tracker() -> (Folder, String, Vec<String>) {
    let folder = Folder::new();
    folder
        .run("simulate --robot abb-irb120 --poses 40 --test-sets 0 --payloads 1,5 --seed 3 --out s")
        .ok();
    let text = folder.text("s/train.csv");
    folder.write("plan.csv", &text);
    let mut rows = text.lines().filter(|line| !line.starts_with('#'));
    let header = rows.next().unwrap().to_owned();
    let rows = rows.map(str::to_owned).collect();
    (folder, header, rows)
}

fn lines(header: &str, rows: &[String]) -> String {
    format!("{header}\n{}\n", rows.join("\n"))
}

/// Measures rows that come all at once; returns the outcome and the documents.
fn measured(folder: &Folder, input: &str, options: &str) -> (Outcome, Vec<Value>) {
    let line = format!("{MEASURE} --json log.json {options}");
    let outcome = folder.run_with_input(&line, input);
    let log = folder.text("log.json");
    let log = log.lines().map(|line| serde_json::from_str(line).unwrap());
    (outcome, log.collect())
}

fn of<'a>(log: &'a [Value], event: &'a str) -> impl Iterator<Item = &'a Value> {
    log.iter().filter(move |d| d["event"] == event)
}

/// An editor saves the file by renaming, from an old state, or it is removed, while rows are measured: those that are
/// confirmed are in the file of that name.
#[test]
fn a_confirmed_row_is_in_the_file_of_its_name() {
    let (folder, header, rows) = tracker();
    let path = folder.path("m.csv");
    let mut session = Session::begin(&folder, &format!("{MEASURE} --json -"));
    assert!(session.say(&header));
    let mut old = String::new();
    for (row, what) in rows.iter().zip(["", "copied", "old", "gone", ""]) {
        match what {
            "gone" => std::fs::remove_file(&path).unwrap(),
            "" => {}
            _ => {
                let now = std::fs::read_to_string(&path).unwrap();
                folder.write("saved.tmp", if what == "old" { &old } else { &now });
                std::fs::rename(folder.path("saved.tmp"), &path).unwrap();
                old = now;
            }
        }
        assert!(session.say(row));
        while session.next().unwrap()["event"] != "accepted" {}
        assert!(
            folder.text("m.csv").ends_with(&format!("{row}\n")),
            "{what}"
        );
    }
    assert_eq!(folder.text("m.csv"), lines(&header, &rows[..5]));
    // Rows that were corrected by hand stay, and nothing that was measured is lost.
    let edited = folder.text("m.csv").replacen(&rows[1], &rows[20], 1);
    folder.write("m.csv", &edited);
    assert!(session.say(&rows[5]));
    while let Some(document) = session.next() {
        assert_ne!(document["event"], "accepted");
    }
    assert_eq!(session.code(), Some(1));
    assert_eq!(folder.text("m.csv"), edited);
    assert_eq!(folder.text("m-rescued-1.csv"), lines(&header, &rows[..6]));
}

/// A row that was copied is no measurement: it is refused, and in a file of another program it does not count.
#[test]
fn copies_do_not_count() {
    let (folder, header, rows) = tracker();
    let mut input = lines(&header, &rows[..8]);
    let (_, log) = measured(&folder, &input, "");
    let expected = |log: &[Value]| of(log, "end").next().unwrap()["expected_mm"].as_f64();
    let alone = expected(&log).unwrap();
    std::fs::remove_file(folder.path("m.csv")).unwrap();
    input += &format!("{}\n", rows[7]).repeat(30);
    let (outcome, log) = measured(&folder, &input, "--until-mm 0.001");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(outcome.stderr.contains("a copy of row 8"), "{outcome:#?}");
    assert_eq!(
        (of(&log, "accepted").count(), of(&log, "refused").count()),
        (8, 30)
    );
    assert_eq!(folder.text("m.csv"), lines(&header, &rows[..8]));
    folder.write("m.csv", &input);
    let (outcome, log) = measured(&folder, "", "");
    assert!(
        outcome.stderr.contains("row 9 is a copy of row 8"),
        "{outcome:#?}"
    );
    assert_eq!(expected(&log), Some(alone));
}

/// A row that is far from its prediction by few others is reported and does not count; good rows are not reported.
#[test]
fn rows_far_off_are_told_while_there_are_few() {
    let (folder, header, rows) = tracker();
    let row = |row: &str, of: &[&str], change: fn(f64) -> f64| {
        let text = changed(&format!("{header}\n{row}\n"), |names, fields| {
            for (name, field) in names.iter().zip(fields.iter_mut()) {
                if of.contains(name) {
                    *field = format!("{}", change(field.parse().unwrap()));
                }
            }
        });
        text.lines().nth(1).unwrap().to_owned()
    };
    for count in [8, 12, 20] {
        let good = lines(&header, &rows[..count]);
        let next = rows[count].as_str();
        for wrong in [
            row(next, &["x_mm"], |x| x + 3.0),
            row(next, &["x_mm", "y_mm", "z_mm"], |x| x / 1e3),
            row(next, &["q5_deg"], |q| {
                q + if q > 0.0 { -10.0 } else { 10.0 }
            }),
        ] {
            let input = format!("{good}{wrong}\n{}\n", rows[count + 1]);
            let (outcome, log) = measured(&folder, &input, "");
            let outliers: Vec<&Value> = of(&log, "outlier").map(|d| &d["row"]).collect();
            assert_eq!(outliers, [&Value::from(count + 1)], "{wrong}: {outcome:#?}");
            assert!(outcome.stderr.contains("units"), "{outcome:#?}");
            let end = of(&log, "end").next().unwrap();
            assert!(end["expected_mm"].as_f64().unwrap() < 0.5, "{end}");
            // Another session says the same of the same file.
            let (_, again) = measured(&folder, "", "");
            assert_eq!(
                of(&again, "outlier").map(|d| &d["row"]).collect::<Vec<_>>(),
                outliers
            );
            std::fs::remove_file(folder.path("m.csv")).unwrap();
        }
    }
}

/// A wrong row among the first is found once a few right ones have come.
#[test]
fn a_wrong_row_among_the_first_is_found() {
    let (folder, header, rows) = tracker();
    for wrong in 0..4 {
        let mut input = rows[..12].to_vec();
        let mut fields: Vec<&str> = rows[wrong].split(',').collect();
        fields[7] = "1.5";
        input[wrong] = fields.join(",");
        let (first, _) = measured(&folder, &lines(&header, &input), "");
        let (again, log) = measured(&folder, "", "");
        for outcome in [first, again] {
            let row = format!("row {} is ", wrong + 1);
            let told = outcome
                .stderr
                .lines()
                .filter(|line| line.contains("other rows predict"));
            assert!(told.clone().all(|line| line.contains(&row)), "{outcome:#?}");
            assert!(told.count() >= 1, "{outcome:#?}");
        }
        let end = of(&log, "end").next().unwrap();
        assert!(end["expected_mm"].as_f64().unwrap() < 0.5, "{end}");
        std::fs::remove_file(folder.path("m.csv")).unwrap();
    }
}

/// Returns the rows with another number in one field of a row.
fn with_field(
    rows: &[String],
    row: usize,
    field: usize,
    change: impl Fn(f64) -> f64,
) -> Vec<String> {
    let mut out = rows.to_vec();
    let mut fields: Vec<String> = out[row].split(',').map(str::to_owned).collect();
    fields[field] = format!("{:.6}", change(fields[field].parse().unwrap()));
    out[row] = fields.join(",");
    out
}

/// A joint that was typed wrong in row 2 makes row 9 contradict the others: one more row shows that row 2 is the wrong one, and
/// row 9 counts.
#[test]
fn a_right_row_that_was_blamed_counts_again() {
    let (folder, header, rows) = tracker();
    let wrong = with_field(&rows[..13], 1, 5, |q5| q5 + 1.0);
    let (outcome, log) = measured(&folder, &lines(&header, &wrong), "");
    let outliers: Vec<&Value> = of(&log, "outlier").map(|d| &d["row"]).collect();
    assert_eq!(outliers, [9, 2], "{outcome:#?}");
    let agree: Vec<&Value> = of(&log, "agree").map(|d| &d["rows"]).collect();
    assert_eq!(agree, [&serde_json::json!([9])]);
    assert!(
        outcome
            .stderr
            .contains("row 9 now agrees with the others and counts"),
        "{outcome:#?}"
    );
    // Row 9 is off the plan, as it is for a session that continues with the file.
    let left = |log: &[Value]| of(log, "next").last().unwrap()["left"].as_u64();
    assert_eq!(left(&log), Some(rows.len() as u64 - 12));
    assert_eq!(left(&measured(&folder, "", "").1), left(&log));
}

/// After a pose that contradicts the others twice, other poses are asked for: one pose does not show what moved.
#[test]
fn what_moved_is_shown_by_other_poses() {
    let (folder, _, _) = tracker();
    let plan = folder.text("plan.csv");
    let plan: Vec<String> = plan.lines().map(str::to_owned).collect();
    let mut session = Session::begin(&folder, &format!("{MEASURE} --json -"));
    let (mut asked, mut outliers, mut found) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(document) = session.next() {
        match document["event"].as_str().unwrap() {
            "next" if asked.len() == 17 => assert!(session.say("end")),
            "next" => {
                let line = document["line"].as_u64().unwrap() as usize;
                let moved = if asked.len() < 12 { 0.0 } else { 3.0 };
                let row = with_field(&plan, line - 1, 8, |y| {
                    y + moved + 1e-3 * asked.len() as f64
                });
                asked.push(line);
                assert!(session.say(&row[line - 1]));
            }
            "outlier" => outliers.push(document["row"].clone()),
            "moved" => found.push(document["found"].as_str().unwrap().to_owned()),
            _ => {}
        }
    }
    assert_eq!(session.code(), Some(0));
    assert_eq!(outliers, [13, 14, 15, 16, 17]);
    let (new, again) = (&asked[12], &asked[13]);
    assert_eq!(new, again, "{asked:?}");
    let different: std::collections::BTreeSet<_> = asked.iter().collect();
    assert_eq!(different.len(), 16, "{asked:?}");
    let last = found.last().unwrap();
    assert!(
        last.starts_with("the tracker or the base of the arm was moved by ")
            && !last.contains("equally"),
        "{found:?}"
    );
}

/// A row that does not count stays so while it cannot be judged, as beside the first row with another payload.
#[test]
fn a_doubted_row_stays_doubted() {
    let (folder, header, rows) = tracker();
    let of = |kg: &str| -> Vec<&String> {
        let own = rows.iter().filter(|row| row.starts_with(kg));
        own.collect()
    };
    let (light, heavy) = (of("1,"), of("5,"));
    let mut fields: Vec<&str> = light[8].split(',').collect();
    fields[7] = "1.5";
    let mut input: Vec<String> = light[..8].iter().map(|row| (*row).clone()).collect();
    input.push(fields.join(","));
    input.push(heavy[0].clone());
    let (first, log) = measured(&folder, &lines(&header, &input), "");
    let (again, resumed) = measured(&folder, "", "");
    for (outcome, log) in [(first, log), (again, resumed)] {
        let outliers = self::of(&log, "outlier").map(|d| &d["row"]);
        assert_eq!(outliers.collect::<Vec<_>>(), [9], "{outcome:#?}");
        for known in self::of(&log, "estimate").skip(8) {
            assert_eq!(known["outlier_rows"], serde_json::json!([9]), "{known}");
        }
        let end = self::of(&log, "end").next().unwrap();
        assert!(end["expected_mm"].as_f64().unwrap() < 0.5, "{end}");
    }
}

/// A row that was left out is one of its plan: another plan has another row in that line.
#[test]
fn a_row_is_left_out_of_its_own_plan() {
    let (folder, header, rows) = tracker();
    let left = |input: &str| {
        let (_, log) = measured(&folder, input, "");
        let next = of(&log, "next").last().unwrap();
        (next["left"].as_u64().unwrap(), next["line"].clone())
    };
    let all = rows.len() as u64;
    assert_eq!(left("skip\n").0, all - 1);
    assert_eq!(left("").0, all - 1);
    let reversed: Vec<String> = rows.iter().rev().cloned().collect();
    folder.write("plan.csv", lines(&header, &reversed));
    assert_eq!(left("").0, all);
}

/// An expected error from few poses is not relied on: the measurement goes on to as many as `calibrate` asks for.
#[test]
fn few_poses_are_not_small_enough() {
    let (folder, header, rows) = tracker();
    let (outcome, log) = measured(&folder, &lines(&header, &rows), "--until-mm 0.5");
    assert_eq!(outcome.code, Some(0), "{outcome:#?}");
    assert!(outcome.stderr.contains("at least 25"), "{outcome:#?}");
    assert_eq!(of(&log, "incomplete").count(), 1);
    assert_eq!(of(&log, "accepted").count(), 25);
    let small =
        of(&log, "estimate").filter(|d| d["expected_mm"].as_f64().is_some_and(|mm| mm < 0.5));
    assert!(small.count() > 5);
    std::fs::remove_file(folder.path("m.csv")).unwrap();
    let (outcome, _) = measured(&folder, &lines(&header, &rows[..20]), "--until-mm 0.5");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
}

/// The program says which columns a row has and which words there are, at the start and when asked.
#[test]
fn columns_and_words_are_told() {
    let (folder, _, _) = tracker();
    let (outcome, log) = measured(&folder, "help\n?\n", "");
    assert_eq!(outcome.code, Some(0), "{outcome:#?}");
    assert_eq!(
        (of(&log, "columns").count(), of(&log, "refused").count()),
        (3, 0)
    );
    for text in [
        "q1_deg",
        "x_mm,y_mm,z_mm,qw,qx,qy,qz",
        "skip",
        "undo 5",
        "help",
    ] {
        assert_eq!(
            outcome.stdout.matches(text).count(),
            3,
            "{text}: {outcome:#?}"
        );
    }
    let columns = of(&log, "columns").next().unwrap();
    assert_eq!(columns["columns"][1], "q1_deg");
}

/// An `undo` that is none says what may follow it, and takes nothing back. Nothing is forecast before a fit.
#[test]
fn an_undo_of_no_row_says_what_it_may_be() {
    let (folder, header, rows) = tracker();
    for (taken, expected) in [
        (0, "a row first: there is none to take back"),
        (1, "\"undo\" or \"undo 1\""),
        (2, "with a number from 1 to 2"),
    ] {
        for wrong in ["undo 0", "undo -1", "undo x", "undo 3", "undo 1 2"] {
            let input = format!("{}{wrong}\n", lines(&header, &rows[..taken]));
            let (outcome, log) = measured(&folder, &input, "");
            let refused: Vec<&Value> = of(&log, "refused").collect();
            let [document] = refused.as_slice() else {
                panic!("{wrong}: {outcome:#?}");
            };
            let counted = if taken == 1 {
                "1 row".to_owned()
            } else {
                format!("{taken} rows")
            };
            let found = format!("\"{wrong}\" after {counted}");
            assert_eq!(document["found"], found.as_str(), "{wrong}");
            let said = document["expected"].as_str().unwrap();
            assert!(said.contains(expected), "{document}");
            assert_eq!(of(&log, "withdrawn").count(), 0);
            assert!(!outcome.stdout.contains("forecast: 0.0"), "{outcome:#?}");
            let _ = std::fs::remove_file(folder.path("m.csv"));
        }
    }
}

/// Rows of another robot are told at the end, instead of a command that refuses them.
#[test]
fn rows_of_another_robot_are_told() {
    let (folder, _, _) = tracker();
    folder
        .run("simulate --robot ur10 --poses 20 --test-sets 0 --payloads 1 --seed 3 --out other")
        .ok();
    let (outcome, _) = measured(&folder, &folder.text("other/train.csv"), "");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(!outcome.stdout.contains("Then:"), "{outcome:#?}");
    assert!(outcome.stderr.contains("robot `ur10`"), "{outcome:#?}");
}

/// Rows in succession that contradict those before show that something moved. `calibrate` refuses the same file.
#[test]
fn what_moved_is_said_and_calibrate_refuses_the_file() {
    let folder = Folder::new();
    folder
        .run("simulate --robot ur10 --touch socket2 --touches 32 --seed 4 --payloads 1 --out s")
        .ok();
    let text = folder.text("s/touches.csv");
    let mut rows = text.lines().filter(|line| !line.starts_with('#'));
    let header = rows.next().unwrap().to_owned();
    let rows: Vec<&str> = rows.collect();
    // The sockets in turn.
    let in_turn = (0..rows.len()).map(|i| rows[i / 2 + rows.len() / 2 * (i % 2)]);
    let in_turn: Vec<String> = in_turn.map(str::to_owned).collect();
    let slipped = changed(&lines(&header, &in_turn[18..]), |names, fields| {
        let joint = names.iter().position(|name| *name == "q4_deg").unwrap();
        let q: f64 = fields[joint].parse().unwrap();
        fields[joint] = format!("{}", q + 1.0);
    });
    let slipped = slipped.lines().skip(1).map(str::to_owned);
    let wrong: Vec<String> = in_turn[..18].iter().cloned().chain(slipped).collect();
    let measure = "measure --robot ur10 s/touches.csv --json log.json";
    for (rows, is_wrong, out) in [(&in_turn, false, "good.csv"), (&wrong, true, "wrong.csv")] {
        let outcome =
            folder.run_with_input(&format!("{measure} --out {out}"), &lines(&header, rows));
        let log = folder.text("log.json");
        let log: Vec<Value> = log
            .lines()
            .map(|l| serde_json::from_str(l).unwrap())
            .collect();
        let moved: Vec<&Value> = of(&log, "moved").map(|d| &d["since"]).collect();
        let line = format!("calibrate --robot ur10 {out} --features s/touches.toml --out m.blob");
        let calibrated = folder.run(&line);
        if is_wrong {
            assert_eq!(moved, [&Value::from(19)], "{outcome:#?}");
            assert_eq!(
                (outcome.code, calibrated.code),
                (Some(1), Some(3)),
                "{outcome:#?}"
            );
            assert!(
                outcome.stderr.contains("something moved since row 19"),
                "{outcome:#?}"
            );
            assert!(
                calibrated.stderr.contains("from line 20 on"),
                "{calibrated:#?}"
            );
        } else {
            assert_eq!(moved.len() + of(&log, "outlier").count(), 0, "{outcome:#?}");
            assert_eq!(
                (outcome.code, calibrated.code),
                (Some(0), Some(0)),
                "{calibrated:#?}"
            );
        }
    }
}
