//! The report: its numbers are those of the JSON document, it loads nothing, and names cannot inject markup.

use serde_json::Value;

use crate::program::{Folder, Outcome, SERIAL, changed, simulated, without};
use crate::texts::texts;

/// Returns the `data` elements of a page: value, JSON pointer, text.
fn numbers(page: &str) -> Vec<(f64, String, String)> {
    let attribute = |tag: &str, name: &str| -> String {
        let begin = format!("{name}=\"");
        let rest = &tag[tag.find(&begin).unwrap_or_else(|| panic!("{tag}")) + begin.len()..];
        rest[..rest.find('"').unwrap()].to_owned()
    };
    let mut out = Vec::new();
    for part in page.split("<data ").skip(1) {
        let (tag, rest) = part.split_once('>').unwrap();
        let text = rest[..rest.find("</data>").unwrap()].to_owned();
        let value = attribute(tag, "value").parse().unwrap();
        out.push((value, attribute(tag, "data-json"), text));
    }
    out
}

/// Returns whether a text is a number, rounded. Shares are in percent.
pub fn is_rounded(value: f64, text: &str) -> bool {
    let decimals = text.split_once('.').map_or(0, |(_, d)| d.len());
    let shown: f64 = text.parse().unwrap();
    let half = 0.5001 * 10f64.powi(-(decimals as i32));
    (shown - value).abs() <= half || (shown - 100.0 * value).abs() <= half
}

/// Asserts that every number on the page is the document's, rounded. Returns how many there are.
#[track_caller]
pub fn check_numbers(page: &str, document: &Value) -> usize {
    let numbers = numbers(page);
    for (value, pointer, text) in &numbers {
        let there = document.pointer(pointer).and_then(Value::as_f64);
        assert_eq!(there, Some(*value), "{pointer}: the page has {text}");
        assert!(
            is_rounded(*value, text),
            "{pointer}: {value} is shown as {text}"
        );
    }
    numbers.len()
}

/// Asserts that a page is complete, small, uses no network and at most its own script, closes its elements, and has no NaN.
#[track_caller]
pub fn check_page(page: &str) {
    const SCRIPT: &str = include_str!("../../src/report/script.js");
    let own = format!("<script>{SCRIPT}</script>");
    let table = page.contains("<table id=\"poses\">");
    assert_eq!(page.matches(&own).count(), usize::from(table));
    assert!(table || !page.contains(" data-poses="));
    let policy = page.find("http-equiv=\"Content-Security-Policy\" content=\"default-src 'none';");
    assert!(policy.is_some_and(|at| at < page.find("<style>").unwrap()));
    let page = &page.replace(&own, "");
    assert!(page.starts_with("<!DOCTYPE html><html lang=\"en\">"));
    assert!(page.ends_with("</body></html>\n"));
    assert!(page.len() < 1_000_000, "{} bytes", page.len());
    for word in [
        "<script",
        "http://",
        "https://",
        "url(",
        "@import",
        "NaN",
        "inf\"",
        "javascript:",
        // Code in a sentence is an element on a page.
        "`",
    ] {
        assert!(!page.contains(word), "{word}");
    }
    for word in ["prefers-color-scheme: dark", "@media print", "viewport"] {
        assert!(page.contains(word), "{word}");
    }
    let mut open: Vec<&str> = Vec::new();
    for part in page.split('<').skip(2) {
        let tag = &part[..part.find('>').unwrap_or_else(|| panic!("{part}"))];
        let name = tag.split([' ', '/']).find(|n| !n.is_empty()).unwrap();
        match (tag.starts_with('/'), name) {
            (true, _) => assert_eq!(open.pop(), Some(name), "</{name}>"),
            (false, "meta" | "link") => {}
            _ => open.push(name),
        }
    }
    assert!(open.is_empty(), "{open:?}");
    for part in page.split("href=\"#").skip(1) {
        let id = &part[..part.find('"').unwrap()];
        assert!(page.contains(&format!("id=\"{id}\"")), "{id}");
    }
}

fn calibrate(folder: &Folder, flags: &str) -> Outcome {
    let line = format!(
        "calibrate --robot {SERIAL} train.csv {flags} --out arm.blob --report report.html --json report.json"
    );
    folder.run(&line)
}

#[test]
fn the_numbers_of_calibrate_are_those_of_the_document() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    folder.write("test.csv", simulated("test1", 30));
    let outcome = calibrate(&folder, "--method poe-gp-load --test test.csv").ok();
    let (page, document) = (folder.text("report.html"), folder.json("report.json"));
    check_page(&page);
    assert!(check_numbers(&page, &document) > 60);

    // The errors are those of the written blob, as another command computes them.
    let evaluated = folder
        .run("evaluate arm.blob test.csv --json -")
        .ok()
        .json();
    let held_out = &document["held_out"];
    assert_eq!(held_out["how"], "test sets");
    assert_eq!(
        held_out["calibrated"]["position_mm"],
        evaluated["sets"][0]["position_mm"]
    );
    let mean = held_out["calibrated"]["position_mm"]["mean"]
        .as_f64()
        .unwrap();
    assert!(
        outcome.stdout.contains(&format!("{mean:.4} mm mean")),
        "{outcome:#?}"
    );
    let methods = held_out["methods"].as_array().unwrap();
    let names: Vec<&str> = methods
        .iter()
        .map(|m| m["method"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["base-tool", "poe", "poe-gp", "poe-gp-load"]);
    assert_eq!(methods[0], held_out["nominal"]);
    assert_eq!(held_out["payloads"].as_array().unwrap().len(), 5);
    assert!(held_out["learning_curve"].as_array().unwrap().len() >= 2);
    let files = document["provenance"]["files"].as_array().unwrap();
    assert_eq!(files.len(), 3);
    for file in files {
        assert!(page.contains(file["sha256"].as_str().unwrap()), "{file}");
    }

    // A second run gives the same bytes.
    calibrate(&folder, "--method poe-gp-load --test test.csv").ok();
    assert_eq!(page, folder.text("report.html"));
}

/// The page of a calibration by touches of every kind has the numbers of the document.
#[test]
fn the_numbers_of_touches_are_those_of_the_document() {
    let folder = Folder::new();
    let kinds = "socket2,plane1,sphere1,wire1,level1,camera1";
    folder
        .run(&format!(
            "simulate --robot ur10 --touch {kinds} --touches 16 --seed 5 --out t"
        ))
        .ok();
    folder
        .run("calibrate --robot ur10 t/touches.csv --out a.blob --report a.html --json a.json")
        .ok();
    let (page, document) = (folder.text("a.html"), folder.json("a.json"));
    check_page(&page);
    assert!(check_numbers(&page, &document) > 50);
    let touches = &document["touches"];
    for feature in touches["features"].as_array().unwrap() {
        assert!(
            page.contains(feature["name"].as_str().unwrap()),
            "{feature}"
        );
    }
    let mean = touches["after"]["mean_mm"].as_f64().unwrap();
    assert!(page.contains(&format!("{mean:.3}</data> mm")), "{mean}");
    let files = document["provenance"]["files"].as_array().unwrap();
    let roles: Vec<&str> = files.iter().map(|f| f["role"].as_str().unwrap()).collect();
    assert_eq!(roles, ["touches", "features", "result"]);
    for file in files {
        assert!(page.contains(file["sha256"].as_str().unwrap()), "{file}");
    }
    // Without a known distance, the page states in mm what stays undetermined.
    folder
        .run("simulate --robot ur10 --touch socket1 --touches 40 --seed 5 --out one")
        .ok();
    folder
        .run("calibrate --robot ur10 one/touches.csv --out b.blob --report b.html --json b.json")
        .ok();
    let (page, document) = (folder.text("b.html"), folder.json("b.json"));
    check_page(&page);
    check_numbers(&page, &document);
    let unseen = document["touches"]["unseen"].as_array().unwrap();
    assert_eq!(unseen[0]["direction"], "size", "{unseen:?}");
    for unseen in unseen {
        assert!(page.contains(unseen["text"].as_str().unwrap()), "{unseen}");
    }
}

/// Cross-validation of the default model gives held-out errors, which are larger than those of the training. The page states
/// what is unknown.
#[test]
fn cross_validation_is_held_out_and_what_is_unknown_is_said() {
    let folder = Folder::new();
    let mut row = 0;
    let csv = simulated("train", 60);
    let csv = changed(&csv, |names, fields| {
        row += 1;
        let x = names.iter().position(|n| *n == "x_mm").unwrap();
        if row == 7 {
            fields[x] = format!("{}", fields[x].parse::<f64>().unwrap() + 25.0);
        }
    });
    let csv = without(&csv, &["payload_kg", "qw", "qx", "qy", "qz"]);
    folder.write("train.csv", &csv);
    let outcome = calibrate(&folder, "--method elastic").ok();
    let (page, document) = (folder.text("report.html"), folder.json("report.json"));
    check_page(&page);
    assert!(check_numbers(&page, &document) > 60);
    let held_out = &document["held_out"];
    assert_eq!(held_out["how"], "cross-validation");
    assert_eq!(
        (&held_out["folds"], &held_out["calibrated"]["poses"]),
        (&5.into(), &60.into())
    );
    // Training errors would be smaller.
    let mean = |errors: &Value| errors["position_mm"]["mean"].as_f64().unwrap();
    assert!(mean(&held_out["calibrated"]) > mean(&document["training"]));
    let line = format!("compare --robot {SERIAL} train.csv --methods elastic --folds 5 --json -");
    let compared = folder.run(&line).ok().json();
    let cross_validation = &compared["methods"][0]["cross_validation"]["position_mm"];
    assert_eq!(&held_out["calibrated"]["position_mm"], cross_validation);
    assert_eq!(document["outliers"][0]["line"], 8);
    for sentence in [
        "no payload_kg column",
        "There is one session only",
        "line 8",
        "left out",
    ] {
        assert!(page.contains(sentence), "{sentence}: {outcome:#?}");
    }
    assert!(!page.contains("mrad on average"));
}

#[test]
fn the_numbers_of_compare_are_those_of_the_document() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 50));
    for set in ["test1", "test2"] {
        folder.write(&format!("{set}.csv"), simulated(set, 20));
    }
    let sets = "--test test1.csv --test test2.csv --folds 0";
    for (flags, how) in [(sets, "test sets"), ("--folds 4", "cross-validation")] {
        let line = format!(
            "compare --robot {SERIAL} train.csv {flags} --methods poe-gp,poe --report report.html --json report.json"
        );
        folder.run(&line).ok();
        let (page, document) = (folder.text("report.html"), folder.json("report.json"));
        check_page(&page);
        assert!(check_numbers(&page, &document) > 50);
        let held_out = &document["held_out"];
        assert_eq!(held_out["how"], how);
        // Base and tool alone are there for comparison; the page is about the best model.
        assert_eq!(held_out["nominal"]["method"], "base-tool");
        assert_eq!(held_out["calibrated"]["method"], "poe-gp");
        if how == "cross-validation" {
            let asked = &document["methods"][0]["cross_validation"]["position_mm"];
            assert_eq!(&held_out["calibrated"]["position_mm"], asked);
        }
    }
    let line = format!("compare --robot {SERIAL} train.csv --folds 0 --report report.html");
    folder.refuses(line);
}

/// Names in sessions, files, robot and serial number that try to break out of text, attributes and the SVG.
#[test]
fn hostile_names_stay_text() {
    let folder = Folder::new();
    let hostile = [
        "<script>alert(1)</script>",
        "\"><img src=x onerror=alert(2)>",
        "'&amp;</title></svg>",
    ];
    let mut row = 0;
    let csv = changed(&simulated("train", 60), |_, fields| {
        fields.push(format!("\"{}\"", hostile[row % 3].replace('"', "\"\"")));
        row += 1;
    });
    let csv = csv.replacen('\n', ",session\n", 1);
    let train = "a<b>&'\"c.csv";
    folder.write(train, &csv);
    let robot = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../calibration/robots/abb-irb4400-serial.toml"
    ))
    .unwrap()
    .replacen(
        "name = \"abb-irb4400-serial\"",
        "name = '</h1><svg onload=alert(3)>'",
        1,
    );
    folder.write("robot.toml", robot);
    let mut command = folder.command(
        "calibrate --robot robot.toml --method poe --out arm.blob --report report.html --json report.json",
    );
    command.arg(train).args(["--serial-number", "<b>7</b>"]);
    folder.finish(&mut command).ok();
    let (page, document) = (folder.text("report.html"), folder.json("report.json"));
    check_page(&page);
    check_numbers(&page, &document);
    assert_eq!(document["held_out"]["tools"].as_array().unwrap().len(), 3);
    assert_eq!(page.matches("<script").count(), 1);
    for word in ["<img", "<svg onload", "<b>7", "</title></svg>", "<b>&'"] {
        assert!(!page.contains(word), "{word}");
    }
    for word in ["&lt;script&gt;", "&lt;img", "&lt;svg onload", "&lt;b&gt;7"] {
        assert!(page.contains(word), "{word}");
    }
}

/// With one pose, one payload and joints that do not move, the page has sentences in place of plots, and is valid.
#[test]
fn a_single_held_out_pose_has_a_page() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 40));
    folder.write("test.csv", simulated("test1", 1));
    calibrate(&folder, "--method poe-gp-load --test test.csv").ok();
    let (page, document) = (folder.text("report.html"), folder.json("report.json"));
    check_page(&page);
    check_numbers(&page, &document);
    for sentence in [
        "Joints 1, 2, 3, 4, 5, 6 did not move",
        "1 poses are too few",
        "all poses are at one place",
        "with one payload",
    ] {
        assert!(page.contains(sentence), "{sentence}");
    }
}

#[test]
fn what_cannot_be_reported_is_refused_before_the_work() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 6));
    folder.write("again.csv", simulated("train", 6));
    folder.write("test.csv", "q1_deg\n1\n");
    for line in [
        "--method poe --accept few --report report.html",
        "--method base-tool --report train.csv",
        "--method base-tool --report arm.blob",
        "--method base-tool --report no/such.html",
        "--method base-tool --test again.csv",
        "--method base-tool --test test.csv",
    ] {
        folder.refuses(format!(
            "calibrate --robot {SERIAL} train.csv --out arm.blob {line}"
        ));
    }
}

/// The page of a check has its own headline, and its numbers are those of the document.
#[test]
fn the_numbers_of_check_are_those_of_the_document() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 100));
    folder.write("fresh.csv", simulated("test2", 20));
    let moved = changed(&simulated("test2", 20), |names, fields| {
        let x = names.iter().position(|n| *n == "x_mm").unwrap();
        fields[x] = format!("{}", fields[x].parse::<f64>().unwrap() + 0.4);
    });
    folder.write("moved.csv", moved);
    let line = format!("calibrate --robot {SERIAL} train.csv --out arm.blob");
    folder.run(&line).ok();
    // The errors, the rate and what could be found; in the other cases also the drift and its parts.
    for (file, code, said, numbers) in [
        ("fresh.csv", 0, "The calibration holds.", 18),
        ("moved.csv", 1, "The calibration does not hold.", 30),
    ] {
        let line =
            format!("check arm.blob {file} --max-mm 0.3 --report check.html --json check.json");
        assert_eq!(folder.run(&line).code, Some(code), "{file}");
        let (page, document) = (folder.text("check.html"), folder.json("check.json"));
        check_page(&page);
        assert!(page.contains(said), "{file}");
        let found = check_numbers(&page, &document);
        assert!(found >= numbers, "{file}: {found}");
        assert_eq!(document["rows"].as_array().unwrap().len(), 20);
    }
    assert!(folder.text("check.html").contains("the base"));
}

/// The page of a corrected program has the numbers of its document, every target before and after, and a reason for each
/// target that is left. Names of the program stay text.
#[test]
fn the_numbers_of_a_corrected_program_are_those_of_the_document() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    let line = format!("calibrate --robot {SERIAL} train.csv --method poe --out arm.blob");
    folder.run(&line).ok();
    let program = std::fs::read(crate::program::data("programs/part.mod")).unwrap();
    let text = String::from_utf8_lossy(&program);
    let more = "      MoveL Offs(p10,0,0,50),v200,z1,gun\\WObj:=table;\n    ENDPROC";
    let name = "a<b>&c.mod";
    folder.write(name, text.replace("    ENDPROC", more));
    let rest = "--payload-kg 2.5 --split 0.02 --report out.html --json out.json --out out.mod";
    let mut command = folder.command(&format!("correct arm.blob {rest}"));
    let outcome = folder.finish(command.arg(name));
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let (page, document) = (folder.text("out.html"), folder.json("out.json"));
    check_page(&page);
    assert!(check_numbers(&page, &document) > 14);
    let corrected = folder.text("out.mod");
    for (start, file) in [
        (":=[[712.804,", &text),
        ("p10:=[[", &corrected.clone().into()),
    ] {
        let at = file.find(start).unwrap() + start.find("[[").unwrap() + 2;
        let numbers = file[at..].split(']').next().unwrap().replace(',', ", ");
        assert!(page.contains(&format!(">{numbers}; ")), "{numbers}");
    }
    for word in [
        "a&lt;b&gt;&amp;c.mod:",
        "its target is computed: Offs(…)",
        "<td>gun</td>",
        "<td>table</td>",
    ] {
        assert!(page.contains(word), "{word}");
    }
    assert!(!page.contains("a<b>"));
    // A second run gives the same bytes.
    let first = page;
    let mut command = folder.command(&format!("correct arm.blob {rest}"));
    folder.finish(command.arg(name));
    assert_eq!(first, folder.text("out.html"));
}
