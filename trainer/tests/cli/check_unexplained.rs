//! `trainer check`: errors that no drift explains are no noise, a drift that does not explain them is not acted on, and
//! orientations that are not judged are said to be so.

use crate::check::folder;
use crate::program::{Folder, changed, simulated};

/// Returns the fresh poses, changed by `change`, which is given the numbers of these columns.
fn fresh<const N: usize>(columns: [&str; N], change: fn([f64; N]) -> [f64; N]) -> String {
    changed(&simulated("test2", 20), |names, fields| {
        let at = columns.map(|column| names.iter().position(|n| *n == column).unwrap());
        let new = change(at.map(|i| fields[i].parse().unwrap()));
        for (i, value) in at.into_iter().zip(new) {
            fields[i] = format!("{value:.12}");
        }
    })
}

const XYZ: [&str; 3] = ["x_mm", "y_mm", "z_mm"];

/// Returns what a check of `file` prints, standard output and error, and its JSON document.
fn checked(folder: &Folder, file: &str, code: i32) -> (String, String, serde_json::Value) {
    let outcome = folder.run(&format!(
        "check arm.blob {file} --json out.json --report out.html"
    ));
    assert_eq!(outcome.code, Some(code), "{outcome:#?}");
    assert!(!outcome.stdout.contains("Noise of these"), "{outcome:#?}");
    (outcome.stdout, outcome.stderr, folder.json("out.json"))
}

/// An instrument with another scale is neither noise nor a moved base: with a wide limit the check passes and warns, with a
/// narrow one it fails and advises against resetting anything.
#[test]
fn what_no_drift_explains_is_said() {
    let folder = folder();
    folder.write("scale.csv", fresh(XYZ, |p| p.map(|x| x * (1.0 + 300e-6))));
    let sigma = "--position-sigma-mm 0.03 --orientation-sigma-mrad 0.05";
    for options in ["", sigma] {
        let line = format!("scale.csv --max-mm 3 --max-drift-mm 3 {options}");
        let (stdout, stderr, document) = checked(&folder, &line, 0);
        assert!(stderr.contains("times what the model expects"), "{stderr}");
        assert!(stderr.contains("links that grew"), "{stderr}");
        let holds = stdout.find("The calibration holds").unwrap();
        assert!(stdout[holds..].contains(", but "), "{stdout}");
        assert!(stdout.contains("(the model states 0.03"), "{stdout}");
        let found = &document["unexplained"];
        assert_eq!(found["is_excess"], true);
        assert!(found["factor"].as_f64().unwrap() > 1.5, "{found}");
        assert!(folder.text("out.html").contains("links that grew"));
    }
    let (_, stderr, document) = checked(&folder, "scale.csv --max-mm 0.1", 1);
    assert!(!stderr.contains("reset the zero of joint"), "{stderr}");
    assert!(!stderr.contains("the rest of the calibration"), "{stderr}");
    if !document["changes"].as_array().unwrap().is_empty() {
        assert!(stderr.contains("is perhaps not their cause"), "{stderr}");
    }
    let (_, stderr, document) = checked(&folder, "fresh.csv --max-mm 0.15", 0);
    assert_eq!(stderr, "");
    assert_eq!(document["unexplained"]["is_excess"], false);
}

/// Whether the rest of a calibration is as it was depends on what the model expects, not on the limit.
#[test]
fn the_rest_is_judged_by_what_the_model_expects() {
    let folder = folder();
    folder.write("base.csv", fresh(["x_mm"], |[x]| [x + 0.3]));
    for limit in ["0.15", "0.02"] {
        let (_, stderr, _) = checked(&folder, &format!("base.csv --max-mm {limit}"), 1);
        let said = "measure the base frame again; the rest of the calibration is as it was";
        assert!(stderr.contains(said), "{limit}: {stderr}");
    }
    // Links are longer, and joint 2 has moved besides.
    folder.write("both.csv", {
        let scaled = |p: [f64; 4]| {
            let [x, y, z] = [p[0], p[1], p[2]].map(|x| x * (1.0 + 300e-6));
            [x, y, z, p[3] + 0.03]
        };
        fresh(["x_mm", "y_mm", "z_mm", "q2_deg"], scaled)
    });
    for limit in ["0.05", "0.4"] {
        let (_, stderr, document) = checked(&folder, &format!("both.csv --max-mm {limit}"), 1);
        assert!(!document["changes"].as_array().unwrap().is_empty());
        assert!(stderr.contains("is perhaps not their cause"), "{stderr}");
        assert!(!stderr.contains("reset the zero of joint"), "{stderr}");
        assert!(!stderr.contains("the rest of the calibration"), "{stderr}");
    }
}

/// A tool that is turned about the target leaves positions as they were: the check says that it judged these alone.
#[test]
fn orientations_that_are_not_judged_are_said() {
    let folder = folder();
    let turned = fresh(["qw", "qx", "qy", "qz"], |[w, x, y, z]| {
        let (a, c) = (0.5e-3, 0.4e-3);
        [
            w - x * a - z * c,
            x + w * a + y * c,
            y + z * a - x * c,
            z + w * c - y * a,
        ]
    });
    folder.write("turned.csv", turned);
    let (stdout, _, document) = checked(&folder, "turned.csv --max-mm 0.15", 0);
    let said = "warning: orientation was not judged, but its mean error is 1.3";
    assert!(stdout.contains(said), "{stdout}");
    assert!(!stdout.contains("change nothing"), "{stdout}");
    assert_eq!(document["orientation_judged"], false);
    let (stdout, _, _) = checked(&folder, "fresh.csv --max-mm 0.15", 0);
    assert!(stdout.contains("Orientation was not judged: "), "{stdout}");
    let line = "check arm.blob turned.csv --max-mm 0.15 --tolerance-mrad 1 --json out.json";
    let outcome = folder.run(line);
    assert!(!outcome.stdout.contains("not judged"), "{outcome:#?}");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
}
