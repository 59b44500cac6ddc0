//! How the plots react to keys, mouse and finger, compared with the measurement files.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use crate::browser::chromium::Browser;
use crate::browser::{open, pages, silent};
use crate::program::Folder;

/// Returns the line number and joints in degrees of every row of a measurement file.
fn joints(folder: &Folder, file: &str) -> Vec<(usize, Vec<f64>)> {
    let text = folder.text(file);
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let columns: Vec<usize> = (1..)
        .map_while(|j| names.iter().position(|n| *n == format!("q{j}_deg")))
        .collect();
    let row = |(i, line): (usize, &str)| {
        let fields: Vec<&str> = line.split(',').collect();
        (
            i + 2,
            columns
                .iter()
                .map(|c| fields[*c].parse().unwrap())
                .collect(),
        )
    };
    lines.enumerate().map(row).collect()
}

/// Returns the line number and the joints in the box of a pose.
#[track_caller]
fn said(tip: &str) -> (usize, Vec<f64>) {
    let line = tip.lines().next().unwrap().rsplit(' ').next().unwrap();
    let joints = tip
        .lines()
        .find_map(|l| l.strip_prefix("joints: "))
        .unwrap_or_else(|| panic!("{tip}"));
    let joints = joints.strip_suffix(" deg").unwrap();
    let joints = joints.split(", ").map(|j| j.parse().unwrap());
    (line.parse().unwrap(), joints.collect())
}

fn points(value: &Value) -> Vec<(f64, f64)> {
    let pair = |p: &Value| (p[0].as_f64().unwrap(), p[1].as_f64().unwrap());
    value.as_array().unwrap().iter().map(pair).collect()
}

fn as_texts(points: &[(f64, f64)]) -> BTreeSet<String> {
    points.iter().map(|p| format!("{p:?}")).collect()
}

/// Tab stops once at each plot, and the arrow keys reach each of its dots; the box shows the values of the file.
#[test]
fn the_keyboard_reaches_every_point() {
    let Some(mut browser) = Browser::start("keys in reports") else {
        return;
    };
    let (folder, _) = pages();
    for (page, file, document) in [
        ("calibrate.html", "train.csv", "calibrate.json"),
        ("check.html", "test.csv", "check.json"),
    ] {
        open(&mut browser, &folder, page);
        let measured = joints(&folder, file);
        let document = folder.json(document);
        let plots = browser.evaluate("tests.plots()");
        let plots = plots.as_array().unwrap();
        let mut stops = Vec::new();
        for _ in 0..200 {
            browser.press("Tab", 0);
            if browser.evaluate("document.activeElement === document.body") == true {
                break;
            }
            let state = browser.evaluate("tests.plots().findIndex((plot) => plot.focused)");
            let Some(at) = state.as_u64() else { continue };
            stops.push(at as usize);
            let plot = &plots[at as usize];
            let (name, plane) = (plot["name"].as_str().unwrap(), &plot["plane"]);
            let joint = name
                .strip_prefix("joint ")
                .map(|rest| rest[..1].parse::<usize>().unwrap());
            let (mut lines, mut reached) = (BTreeSet::new(), BTreeSet::new());
            browser.press("Home", 0);
            let mut before = String::new();
            loop {
                let state = browser.evaluate("tests.state()");
                let tip = state["tip"].as_str().unwrap();
                if tip == before {
                    break;
                }
                assert_eq!(
                    state["whole"], true,
                    "{page}, {name}: the box is cut off: {tip}"
                );
                before = tip.to_owned();
                // A screen reader gets the text that is shown.
                let heard = state["said"].as_str().unwrap();
                assert_eq!(heard, tip.trim().replace('\n', "; "), "{page}, {name}");
                let (line, angles) = said(tip);
                let truth = &measured.iter().find(|m| m.0 == line).unwrap().1;
                assert_eq!(truth.len(), angles.len());
                for (there, here) in truth.iter().zip(&angles) {
                    assert!((there - here).abs() < 0.005_1, "{page}: {tip}: {truth:?}");
                }
                if let Some(rows) = document["rows"].as_array() {
                    let row = rows.iter().find(|row| row["line"] == line).unwrap();
                    let error = format!("{:.4}", row["position_mm"].as_f64().unwrap());
                    assert!(
                        tip.contains(&format!("position error: {error} mm")),
                        "{tip}"
                    );
                }
                for core in state["cores"].as_array().unwrap() {
                    for (x, y) in points(core) {
                        reached.insert(format!("{:?}", (x, y)));
                        // The dot of this line is at the joint value of this line.
                        if let Some(j) = joint {
                            let (low, high) = (
                                plot["ends"][0].as_f64().unwrap(),
                                plot["ends"][1].as_f64().unwrap(),
                            );
                            let share = (truth[j - 1] - low) / (high - low);
                            let at =
                                plane[0].as_f64().unwrap() + share * plane[2].as_f64().unwrap();
                            assert!(
                                (at - x).abs() < 0.06,
                                "{page}, {name}: {tip}: {x} instead of {at}"
                            );
                        }
                    }
                }
                lines.insert(line);
                browser.press("ArrowRight", 0);
            }
            let all: BTreeSet<usize> = measured.iter().map(|m| m.0).collect();
            assert_eq!(lines, all, "{page}, {name}");
            let series = plot["series"].as_array().unwrap().iter();
            let dots = as_texts(&series.flat_map(points).collect::<Vec<_>>());
            assert_eq!(reached, dots, "{page}, {name}");
        }
        let each: Vec<usize> = (0..plots.len()).collect();
        assert_eq!(stops, each, "{page}");
        silent(&browser);
    }
    // The largest error in the table is that of the document.
    open(&mut browser, &folder, "calibrate.html");
    let largest = "Math.max(...Array.from(document.querySelectorAll('#poses tbody tr'), (row) => Number(row.cells[1].textContent)))";
    let largest = browser.evaluate(largest).as_f64().unwrap();
    let document = folder.json("calibrate.json");
    let max = &document["held_out"]["calibrated"]["position_mm"]["max"];
    assert!(
        (largest - max.as_f64().unwrap()).abs() < 5.1e-5,
        "{largest} {max}"
    );
    let line = browser.text("tests.text()");
    assert!(line.contains("All 60 poses"));
    // Escape closes the box.
    browser.evaluate("document.querySelector('svg[data-plane]').focus()");
    browser.press("End", 0);
    assert_ne!(browser.evaluate("tests.state().tip"), "");
    browser.press("Escape", 0);
    assert_eq!(browser.evaluate("tests.state().tip"), "");
}

/// Dragging over the plot of a joint marks, in all plots, the poses in that range of the joint according to the file.
#[test]
fn a_range_of_a_joint_is_marked_everywhere() {
    let Some(mut browser) = Browser::start("marking in reports") else {
        return;
    };
    let (folder, _) = pages();
    open(&mut browser, &folder, "calibrate.html");
    let measured = joints(&folder, "train.csv");
    let expression = "tests.plots().findIndex((plot) => plot.name === 'joint 2 (deg)')";
    let index = browser.evaluate(expression).as_u64().unwrap() as usize;
    browser.evaluate(&format!(
        "document.querySelectorAll('svg[data-plane]')[{index}].scrollIntoView({{block: 'center'}})"
    ));
    let plots = browser.evaluate("tests.plots()");
    let plot = &plots[index];
    let number = |value: &Value| value.as_f64().unwrap();
    let [left, top, width] = [0, 1, 2].map(|i| number(&plot["plane"][i]));
    let (low, high) = (number(&plot["ends"][0]), number(&plot["ends"][1]));
    let scale = number(&plot["box"]["scale"]);
    let window = |x: f64, y: f64| {
        (
            number(&plot["box"]["left"]) + scale * x,
            number(&plot["box"]["top"]) + scale * y,
        )
    };
    let share = |angle: f64| (angle - low) / (high - low);
    let mut shares: Vec<f64> = measured.iter().map(|m| share(m.1[1])).collect();
    shares.sort_by(f64::total_cmp);
    // Each end of the range lies midway between two neighbouring poses.
    let between = |least: f64| {
        let pairs = shares.windows(2).filter(|pair| pair[0] > least);
        let close = pairs.map(|pair| (pair[1] - pair[0], 0.5 * (pair[0] + pair[1])));
        let close = close.filter(|(gap, middle)| *gap > 0.004 && *middle < least + 0.2);
        close.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap().1
    };
    let (from, to) = (between(0.2), between(0.6));
    browser.mouse("mouseMoved", window(left + from * width, top + 20.0));
    browser.mouse("mousePressed", window(left + from * width, top + 20.0));
    for share in [0.45, 0.5, to] {
        let place = window(left + share * width, top + 60.0);
        browser.call(
            "Input.dispatchMouseEvent",
            json!({"type": "mouseMoved", "x": place.0, "y": place.1, "button": "left", "buttons": 1}),
        );
    }
    browser.mouse("mouseReleased", window(left + to * width, top + 60.0));
    let inside: Vec<&(usize, Vec<f64>)> = measured
        .iter()
        .filter(|m| (from..to).contains(&share(m.1[1])))
        .collect();
    assert!((5..50).contains(&inside.len()));
    let after = browser.evaluate("tests.plots()");
    for plot in after.as_array().unwrap() {
        let name = plot["name"].as_str().unwrap();
        for (marked, all) in plot["marked"]
            .as_array()
            .unwrap()
            .iter()
            .zip(plot["series"].as_array().unwrap())
        {
            assert_eq!(points(marked).len(), inside.len(), "{name}");
            assert!(
                as_texts(&points(marked)).is_subset(&as_texts(&points(all))),
                "{name}"
            );
            // Compared with the file: values of another joint on the same lines.
            let Some(joint) = name.strip_prefix("joint ") else {
                continue;
            };
            let joint: usize = joint[..1].parse().unwrap();
            let (low, high) = (number(&plot["ends"][0]), number(&plot["ends"][1]));
            let plane = [0, 2].map(|i| number(&plot["plane"][i]));
            let place = |m: &&(usize, Vec<f64>)| {
                plane[0] + plane[1] * (m.1[joint - 1] - low) / (high - low)
            };
            let mut wanted: Vec<f64> = inside.iter().map(place).collect();
            let mut found: Vec<f64> = points(marked).iter().map(|p| p.0).collect();
            wanted.sort_by(f64::total_cmp);
            found.sort_by(f64::total_cmp);
            for (a, b) in wanted.iter().zip(&found) {
                assert!((a - b).abs() < 0.06, "{name}: {a} {b}");
            }
        }
    }
    // The panel shows their number and their mean error, which the table has too.
    let lines: Vec<usize> = inside.iter().map(|m| m.0).collect();
    let errors = browser.evaluate("Array.from(document.querySelectorAll('#poses tbody tr'), (row) => [row.cells[0].textContent, Number(row.cells[1].textContent)])");
    let errors = errors.as_array().unwrap().iter();
    let error = |row: &Value| {
        let line: usize = row[0]
            .as_str()
            .unwrap()
            .strip_prefix("line ")
            .unwrap()
            .parse()
            .unwrap();
        lines.contains(&line).then(|| number(&row[1]))
    };
    let errors: Vec<f64> = errors.filter_map(error).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let panel = browser.text("tests.panel()");
    let expected = format!("{} of 60 poses are marked: joint 2 from ", inside.len());
    assert!(panel.starts_with(&expected), "{panel}");
    assert!(
        panel.contains(&format!("Mean position error {mean:.3} mm, of the others ")),
        "{panel}"
    );
    // The box belongs to the dot under the pointer.
    let (line, angles) = (measured[6].0, &measured[6].1);
    let x = left + width * share(angles[1]);
    let dots = points(&plot["series"][1]);
    let dot = dots.iter().find(|d| (d.0 - x).abs() < 0.06).unwrap();
    browser.mouse("mouseMoved", window(dot.0, dot.1));
    let state = browser.evaluate(&format!("tests.state({index})"));
    assert_eq!(said(state["tip"].as_str().unwrap()).0, line);
    // The same for a dot under a finger that is then lifted.
    browser.call(
        "Emulation.setTouchEmulationEnabled",
        json!({"enabled": true}),
    );
    let other = dots.iter().find(|d| (d.0 - x).abs() > 60.0).unwrap();
    let (x, y) = window(other.0, other.1);
    for (kind, points) in [
        ("touchStart", json!([{"x": x, "y": y}])),
        ("touchEnd", json!([])),
    ] {
        browser.call(
            "Input.dispatchTouchEvent",
            json!({"type": kind, "touchPoints": points}),
        );
    }
    let state = browser.evaluate(&format!("tests.state({index})"));
    let reached = state["cores"].as_array().unwrap().iter().flat_map(points);
    assert!(
        as_texts(&reached.collect::<Vec<_>>()).contains(&format!("{other:?}")),
        "{state}"
    );
    assert_ne!(said(state["tip"].as_str().unwrap()).0, line);
    browser.press("Escape", 0);
    assert_eq!(browser.text("tests.panel()"), "");
    let marks = browser.evaluate("tests.plots().flatMap((plot) => plot.marked.flat()).length");
    assert_eq!(marks, 0);
    silent(&browser);
}
