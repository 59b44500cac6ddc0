//! Models by touches: evaluating, comparing and checking them, and repeating them from a project.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::program::{Folder, changed};
use crate::report::{check_numbers, check_page};
use crate::texts::texts;

/// Returns an arm with two models by sockets, and fresh touches of other features. The same seed gives the same arm.
fn folder() -> Folder {
    let folder = Folder::new();
    for (kinds, touches, out) in [
        ("socket4", 60, "many"),
        ("socket2", 12, "few"),
        ("socket2,wire1,plane1", 24, "fresh"),
    ] {
        let line = format!(
            "simulate --robot abb-irb120 --payloads 1 --touch {kinds} --touches {touches} --seed 3 --out {out}"
        );
        folder.run(&line).ok();
    }
    for name in ["many", "few"] {
        folder
            .run(&format!(
                "calibrate --robot abb-irb120 {name}/touches.csv --out {name}.blob"
            ))
            .ok();
    }
    folder
}

/// The default correction limit covers the whole work volume; at the few states of a plan alone it would be smaller.
#[test]
fn a_model_of_planned_touches_is_not_limited_elsewhere() {
    let folder = Folder::new();
    for line in [
        "plan --robot ur10 --touch socket=600,100,500 --touch socket=400,-300,500 --count 40 --seed 2 --out touches.csv \
         --features-out touches.toml",
        "simulate --robot ur10 --touch-plan touches.csv --seed 52 --out practice",
        "calibrate --robot ur10 practice/touches.csv --out default.blob",
        "calibrate --robot ur10 practice/touches.csv --max-correction-mm 50 --max-correction-mrad 100 --out wide.blob",
    ] {
        folder.run(line).ok();
    }
    let mean = |blob: &str| {
        let line = format!("evaluate {blob} practice/truth.csv --json -");
        let found = folder.run(&line).ok().json();
        found["sets"][0]["position_mm"]["mean"].as_f64().unwrap()
    };
    let (default, wide) = (mean("default.blob"), mean("wide.blob"));
    assert!(default < 1.02 * wide, "{default} and {wide} mm");
}

/// All kinds that `plan --touch` asks for can be practised: the simulated arm touches sockets and plates and reads wires.
#[test]
fn a_plan_of_all_kinds_is_practised() {
    let folder = Folder::new();
    let goals = "--touch plane=600,0,400 --touch wire=900,-600,30 --touch socket=600,100,500";
    for line in [
        &format!(
            "plan --robot ur10 {goals} --count 60 --out touches.csv --features-out touches.toml"
        ),
        "simulate --robot ur10 --touch-plan touches.csv --seed 4 --out practice",
        "calibrate --robot ur10 practice/touches.csv --out arm.blob",
    ] {
        folder.run(line).ok();
    }
    let found = folder.run("evaluate arm.blob practice/truth.csv --json -");
    let found = found.ok().json();
    let mean = found["sets"][0]["position_mm"]["mean"].as_f64().unwrap();
    assert!(mean < 0.3, "{mean} mm; 1.7 mm nominal");
}

/// Returns the rows of a simulated touch file after its comment.
fn rows(csv: &str) -> String {
    csv.lines().skip(1).fold(String::new(), |mut out, line| {
        writeln!(out, "{line}").unwrap();
        out
    })
}

/// Touches do not determine where an instrument stands, so measured poses get a base of their own without an option.
#[test]
fn measured_poses_have_a_base_of_their_own() {
    let folder = folder();
    for asked in ["", " --fit-base"] {
        let line = format!("evaluate many.blob fresh/truth.csv{asked}");
        let outcome = folder.run(&line).ok();
        assert!(outcome.stdout.contains("by touches, which do not show"));
        let document = folder.run(&format!("{line} --json -")).ok().json();
        assert_eq!(document["base_fitted"], true);
        let mean = document["sets"][0]["position_mm"]["mean"].as_f64().unwrap();
        assert!(mean < 0.15, "{mean}");
    }
    let checked = folder
        .run("check many.blob fresh/truth.csv --max-mm 0.5")
        .ok();
    assert!(checked.stdout.contains("by touches, which do not show"));
    let shown = folder.run("inspect many.blob").ok();
    assert!(shown.stdout.contains("by touches alone"), "{shown:#?}");
    // A user who states the base determines it.
    folder
        .run("calibrate --robot abb-irb120 many/touches.csv --base-from 0,0,0,1,0,0,0 --out stated.blob")
        .ok();
    let document = folder
        .run("evaluate stated.blob fresh/truth.csv --json -")
        .ok()
        .json();
    assert_eq!(document["base_fitted"], false);
}

#[test]
fn evaluate_has_a_table_of_features() {
    let _texts = texts();
    let folder = folder();
    let line = "evaluate many.blob fresh/touches.csv";
    let outcome = folder.run(line).ok().said();
    for name in ["socket/0", "socket/1", "wire/0", "plane/0"] {
        assert!(outcome.stdout.contains(name), "{outcome:#?}");
    }
    let document = folder.run(&format!("{line} --json -")).ok().json();
    let found = &document["touches"];
    assert_eq!(found["features"].as_array().unwrap().len(), 4);
    assert_eq!(found["residuals"].as_array().unwrap().len(), 72);
    assert!(found["ratio"].as_f64().unwrap() < 0.6, "{found}");
    let rms = |which: usize| found["features"][0]["rms"][which].as_f64().unwrap();
    assert!(rms(1) < rms(0), "{found}");
    // One wrong row is named and changes little.
    let csv = rows(&folder.text("fresh/touches.csv"));
    let mut row = 0;
    let csv = changed(&csv, |names, fields| {
        row += 1;
        if row == 5 {
            let joint = names.iter().position(|name| *name == "q2_deg").unwrap();
            let q: f64 = fields[joint].parse().unwrap();
            fields[joint] = (q + 0.5).to_string();
        }
    });
    folder.write("bad.csv", csv);
    let outcome = folder
        .run("evaluate many.blob bad.csv --features fresh/touches.toml")
        .ok();
    assert!(
        outcome.stderr.contains("1 of 72 rows are outliers"),
        "{outcome:#?}"
    );
    assert!(outcome.stderr.contains("line 6 by"), "{outcome:#?}");
    folder.refuses("evaluate many.blob fresh/touches.csv --fit-base");
    folder.refuses("evaluate many.blob fresh/touches.csv --features none.toml");
    folder.write(
        "empty.csv",
        "feature,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n",
    );
    folder.write("empty.toml", folder.text("fresh/touches.toml"));
    folder.refuses("evaluate many.blob empty.csv");
}

/// Tracker rows in the same file are summarised on a line of their own, with positions and rotations apart.
#[test]
fn rows_of_a_tracker_are_judged_beside_touches() {
    let _texts = texts();
    let folder = folder();
    let touches = rows(&folder.text("fresh/touches.csv"));
    let truth = rows(&folder.text("fresh/truth.csv"));
    let names: Vec<&str> = touches.lines().next().unwrap().split(',').collect();
    let mut csv = format!("{},x_mm,y_mm,z_mm\n", names.join(","));
    for line in touches.lines().skip(1) {
        writeln!(csv, "{line},,,").unwrap();
    }
    let header: Vec<&str> = truth.lines().next().unwrap().split(',').collect();
    for line in truth.lines().skip(1).take(20) {
        let fields: Vec<&str> = line.split(',').collect();
        let field = |name: &str| {
            let at = header.iter().position(|known| *known == name);
            at.map_or("", |at| fields[at])
        };
        let all = names.iter().chain(&["x_mm", "y_mm", "z_mm"]);
        let all: Vec<&str> = all.map(|name| field(name)).collect();
        writeln!(csv, "{}", all.join(",")).unwrap();
    }
    folder.write("mixed.csv", csv);
    folder.write("mixed.toml", folder.text("fresh/touches.toml"));
    let document = folder
        .run("evaluate many.blob mixed.csv --json -")
        .ok()
        .json();
    let tracker = document["touches"]["tracker"].as_array().unwrap();
    assert_eq!(tracker.len(), 1, "{document}");
    assert_eq!(tracker[0]["rows"], 20);
    let rms = |which: usize| tracker[0]["rms"][which].as_f64().unwrap();
    assert!(rms(1) < 0.5 * rms(0), "{tracker:?}");
    folder
        .run("calibrate --robot abb-irb120 mixed.csv --out mixed.blob")
        .ok()
        .said();
}

#[test]
fn models_are_compared_by_touches() {
    let _texts = texts();
    let folder = folder();
    let line = "compare --robot abb-irb120 fresh/touches.csv --blob few.blob --blob many.blob";
    folder.run(line).ok().said();
    let document = folder.run(&format!("{line} --json -")).ok().json();
    let ratio = |model: usize| {
        document["models"][model]["touches"]["ratio"]
            .as_f64()
            .unwrap()
    };
    assert!(ratio(1) < ratio(0), "{document}");
    // The page has the numbers of the document.
    let outcome = folder.run(&format!("{line} --report page.html --json page.json"));
    outcome.ok().said();
    let page = folder.text("page.html");
    check_page(&page);
    assert!(check_numbers(&page, &folder.json("page.json")) > 30);
    assert!(
        page.contains(r#"<b class="calibrated">many.blob</b> describes"#),
        "{page}"
    );
    assert!(!page.contains("Warning"), "{page}");
    // Touches that a model was calibrated with.
    let own = line.replace("fresh/", "many/");
    let outcome = folder
        .run(&format!("{own} --report page.html --json page.json"))
        .ok()
        .said();
    assert!(outcome.stderr.contains("its errors elsewhere are larger"));
    let document = folder.json("page.json");
    assert_eq!(document["models"][0]["training_data"], false);
    assert_eq!(document["models"][1]["training_data"], true);
    let warning = "</b>many.blob was calibrated with these touches.";
    assert!(folder.text("page.html").contains(warning));
    folder.refuses("compare --robot abb-irb120 fresh/touches.csv");
    folder.refuses("compare --robot ur10 fresh/touches.csv --blob many.blob");
    folder.refuses("compare --robot abb-irb120 fresh/truth.csv --blob many.blob");
    folder.refuses(format!("{line} --folds 3 --test few/touches.csv"));
    folder.refuses(format!("{line} --folds 10"));
    folder.refuses(format!("{line} --outliers keep"));
}

#[test]
fn touches_show_whether_a_calibration_holds() {
    let _texts = texts();
    let folder = folder();
    let line = "check many.blob fresh/touches.csv --max-mm 0.3";
    folder.run(line).ok().said();
    let document = folder.run(&format!("{line} --json -")).ok().json();
    assert_eq!(document["holds"], true);
    assert!(document["touches"]["size_ppm"].is_number(), "{document}");
    // A change that moves the tip by more than matters, and that these touches may not show, is warned of.
    let sensitivity = document["touches"]["sensitivity"].as_array().unwrap();
    let moves = sensitivity.iter().filter_map(|s| s["moves_mm"].as_f64());
    let most = moves.fold(0.0, f64::max);
    assert!(most > 0.05, "{document}");
    for (limit, is_hidden) in [(0.99 * most, true), (1.01 * most, false)] {
        let outcome = folder.run(&format!("{line} --max-drift-mm {limit}")).ok();
        assert_eq!(
            outcome.stdout.contains("may be hidden"),
            is_hidden,
            "{outcome:#?}"
        );
    }
    // The controller reports 0.3 degrees less for joint 3.
    let csv = rows(&folder.text("fresh/touches.csv"));
    let csv = changed(&csv, |names, fields| {
        let joint = names.iter().position(|name| *name == "q3_deg").unwrap();
        let q: f64 = fields[joint].parse().unwrap();
        fields[joint] = (q - 0.3).to_string();
    });
    folder.write("lost.csv", csv);
    let lost = "check many.blob lost.csv --features fresh/touches.toml --max-mm 0.3";
    let outcome = folder.run(lost).said();
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(outcome.stdout.contains("joint 3 is off by"), "{outcome:#?}");
    assert!(
        outcome.stderr.contains("reset the zero of joint 3"),
        "{outcome:#?}"
    );
    // Both pages have the numbers of their documents.
    for (line, code, verdict) in [(line, 0, "holds. "), (lost, 1, "does not hold. ")] {
        let outcome = folder.run(&format!("{line} --report check.html --json check.json"));
        assert_eq!(outcome.code, Some(code), "{outcome:#?}");
        let page = folder.text("check.html");
        check_page(&page);
        let document = serde_json::from_str(&folder.text("check.json")).unwrap();
        assert!(check_numbers(&page, &document) > 12);
        assert!(page.contains(&format!("The calibration {verdict}")));
        let named = page.contains("<td>joint 3 is off by</td>");
        assert_eq!(named, code == 1, "{page}");
    }
    folder.refuses(format!("{line} --fit-tool"));
    folder.refuses("check many.blob many/touches.csv --max-mm 0.3");
    // A socket without a known distance does not determine the arm's size; three touches determine nothing.
    let toml = folder.text("few/touches.toml");
    let alone = &toml[..toml.find("[[distance]]").unwrap()];
    folder.write("alone.toml", alone);
    let unsized_line = "check many.blob few/touches.csv --features alone.toml --max-mm 0.3";
    let outcome = folder.run(unsized_line);
    assert!(
        outcome
            .stdout
            .contains("They show no change of the arm's size"),
        "{outcome:#?}"
    );
    let csv = folder.text("few/touches.csv");
    let few: Vec<&str> = csv
        .lines()
        .take(2)
        .chain(csv.lines().skip(2).take(3))
        .collect();
    folder.write("three.csv", few.join("\n"));
    let feature = alone.rfind("[[feature]]").unwrap();
    folder.write("three.toml", &alone[..feature]);
    folder.refuses("check many.blob three.csv --max-mm 0.3");
}

/// A project of touches gives the same bytes, and names the features file with its checksum.
/// Touches of another arm leave errors that no joint explains. A joint that touches hardly see is not blamed for them: its
/// zero would be off by any number of degrees, and the tip by metres.
#[test]
fn a_joint_that_touches_do_not_show_is_not_blamed() {
    let folder = Folder::new();
    for line in [
        "simulate --robot ur10 --touch socket2,plane1 --touches 40 --seed 1 --out one",
        "simulate --robot ur10 --touch socket2,plane1 --touches 30 --seed 2 --out other",
        "calibrate --robot ur10 one/touches.csv --out one.blob",
    ] {
        folder.run(line).ok();
    }
    let outcome = folder.run("check one.blob other/touches.csv --max-mm 1 --json -");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let found = outcome.json();
    let found = &found["touches"];
    let sensitivity = found["sensitivity"].as_array().unwrap();
    let unseen = sensitivity.iter().filter(|s| s["smallest"].is_null());
    let unseen: Vec<&Value> = unseen.map(|s| &s["part"]).collect();
    assert!(unseen.contains(&&json!({ "joint": 1 })), "{found:#}");
    let changes = found["changes"].as_array().unwrap();
    assert!(!changes.is_empty());
    for change in changes {
        assert!(!unseen.contains(&&change["part"]), "{change:#}");
    }
    let effect = found["effect_mm"]["max"].as_f64().unwrap();
    assert!(effect < 20.0, "{effect} mm");
}

#[test]
fn a_project_of_touches_repeats_its_blob() {
    let _texts = texts();
    let folder = folder();
    let line = "calibrate --robot abb-irb120 many/touches.csv --features many/touches.toml --serial-number 7 --out a.blob \
                --write-project many/project.toml";
    folder.run(line).ok().said();
    let project = folder.text("many/project.toml");
    assert!(project.contains("features = \"touches.toml\""), "{project}");
    let blob = folder.read("a.blob");
    std::fs::remove_file(folder.path("a.blob")).unwrap();
    let later = folder
        .run_dated("calibrate many/project.toml", "1900000000")
        .ok()
        .said();
    assert_eq!(folder.read("a.blob"), blob);
    assert!(later.stdout.contains("byte for byte"), "{later:#?}");
    assert_eq!(later.stderr, "", "nothing was overridden");
    folder.write("other.toml", folder.text("many/touches.toml"));
    let other = "calibrate many/project.toml --features other.toml --out b.blob";
    let outcome = folder.run(other).ok();
    assert!(
        outcome.stderr.contains("overrides data.features"),
        "{outcome:#?}"
    );
    folder.write("many/touches.toml", folder.text("few/touches.toml"));
    folder.refuses("calibrate many/project.toml --out c.blob");
}
