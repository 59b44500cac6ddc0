//! Robots of every kind from end to end.

use serde_json::Value;

use crate::program::{Folder, SERIAL, changed, data, simulated};

/// Returns the mean position error of a model on the first test set.
fn mean(document: &Value, model: &str) -> f64 {
    let models = document["methods"].as_array().unwrap();
    let found = models.iter().find(|m| m["method"] == model).unwrap();
    found["sets"][0]["position_mm"]["mean"].as_f64().unwrap()
}

/// Returns rows of a simulated set whose third joint is the controller's, `q3 = q2 + q3_serial`, or the serial one.
fn counted(set: &str, poses: usize, by_controller: bool) -> String {
    changed(&simulated(set, poses), |names, fields| {
        let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
        let (q2, q3) = (at("q2_deg"), at("q3_deg"));
        if by_controller {
            let sum = fields[q2].parse::<f64>().unwrap() + fields[q3].parse::<f64>().unwrap();
            fields[q3] = format!("{sum:.10}");
        }
    })
}

/// A parallelogram arm has the errors of the serial arm with other joint values.
#[test]
fn a_coupled_arm_has_the_errors_of_the_serial_one() {
    let folder = Folder::new();
    for (name, by_controller) in [("serial", false), ("coupled", true)] {
        folder.write(
            &format!("{name}_train.csv"),
            counted("train", 300, by_controller),
        );
        folder.write(
            &format!("{name}_test.csv"),
            counted("test1", 100, by_controller),
        );
    }
    let run = |robot: &str, name: &str| {
        let line = format!(
            "compare --robot {robot} {name}_train.csv --test {name}_test.csv --folds 0 --outliers keep --json -"
        );
        folder.run(&line).ok().json()
    };
    // Outliers are kept, because the search for outliers depends on the controller's joints as well.
    let (serial, coupled) = (run(SERIAL, "serial"), run("abb-irb4400", "coupled"));
    for model in ["base-tool", "poe"] {
        let (a, b) = (mean(&serial, model), mean(&coupled, model));
        assert!((a - b).abs() < 1e-4, "{model}: {a} {b}");
    }
    // A process depends on the controller's joints, so its errors are similar but not equal.
    for model in ["poe-gp", "poe-gp-load"] {
        let (a, b) = (mean(&serial, model), mean(&coupled, model));
        assert!((a / b - 1.0).abs() < 0.2, "{model}: {a} {b}");
    }
    // The blob takes the controller's joints too, and contains the coupling itself.
    let line = "calibrate --robot abb-irb4400 coupled_train.csv --method poe --outliers keep --out arm.blob";
    folder.run(line).ok();
    let document = folder
        .run("evaluate arm.blob coupled_test.csv --json -")
        .ok()
        .json();
    let error = document["sets"][0]["position_mm"]["mean"].as_f64().unwrap();
    assert!((error - mean(&coupled, "poe")).abs() < 1e-9);
}

/// The same arm as a built-in robot, as a URDF and as a TOML description.
#[test]
fn descriptions_of_one_arm_agree() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    folder.write("test.csv", simulated("test1", 30));
    let urdf = data("robots/abb_irb4400_60.urdf");
    let toml = data("../../calibration/robots/abb-irb4400-serial.toml");
    let run = |robot: &str| {
        let line = format!(
            "compare --robot {robot} train.csv --test test.csv --methods base-tool,poe --folds 0 --json -"
        );
        folder.run(&line).ok().json()
    };
    let built_in = run(SERIAL);
    for robot in [
        urdf.display().to_string(),
        format!("{} --base base_link --tip tool0", urdf.display()),
        toml.display().to_string(),
    ] {
        let other = run(&robot);
        for model in ["base-tool", "poe"] {
            let (a, b) = (mean(&built_in, model), mean(&other, model));
            assert!((a - b).abs() < 1e-4, "{robot} {model}: {a} {b}");
        }
    }
}

/// Runs simulate, compare, calibrate and evaluate; every model must be better than the one before.
#[track_caller]
fn from_end_to_end(folder: &Folder, robot: &str, joints: usize) {
    let line = format!(
        "simulate --robot {robot} --poses 120 --payloads 1,3,6 --test-sets 1 --test-poses 60 --seed 3 --out cell"
    );
    folder.run(&line).ok();
    let line =
        format!("compare --robot {robot} cell/train.csv --test cell/test1.csv --folds 0 --json -");
    let document = folder.run(&line).ok().json();
    let errors = ["base-tool", "poe", "poe-gp-load"].map(|model| mean(&document, model));
    println!("{robot}: base-tool, POE, POE + GP with loading {errors:.3?} mm");
    assert!(errors[1] < 0.6 * errors[0], "{robot}: {errors:?}");
    assert!(errors[2] < 0.7 * errors[1], "{robot}: {errors:?}");

    let line = format!(
        "calibrate --robot {robot} cell/train.csv --method poe-gp-load --out arm.blob --json -"
    );
    let document = folder.run(&line).ok().json();
    assert_eq!(document["step1"]["parameters"], 6 * (joints + 1));
    let line = "evaluate arm.blob cell/test1.csv --json - --predictions out.csv";
    let error = folder.run(line).ok().json()["sets"][0]["position_mm"]["mean"].clone();
    assert!((error.as_f64().unwrap() - errors[2]).abs() < 1e-9);
    let facts = folder.run("inspect arm.blob --json -").ok().json();
    assert_eq!(facts["robot"]["joints"].as_array().unwrap().len(), joints);
}

#[test]
fn seven_revolute_joints() {
    from_end_to_end(&Folder::new(), "kuka-iiwa7", 7);
}

#[test]
fn a_rail_and_six_revolute_joints() {
    let folder = Folder::new();
    let arm = std::fs::read_to_string(data("../../calibration/robots/ur10.toml")).unwrap();
    let rail = "[[joint]]\nname = \"rail\"\nkind = \"prismatic\"\nlimits_mm = [0, 1500]\n\
                a_m = 0\nd_m = 0\nalpha_deg = 90\n\n[[joint]]\n";
    folder.write("rail.toml", arm.replacen("[[joint]]\n", rail, 1));
    from_end_to_end(&folder, "rail.toml", 7);
    let header = folder.text("cell/train.csv");
    assert!(header.contains("payload_kg,q1_mm,q2_deg"), "{header}");
}

#[test]
fn three_joints_with_a_prismatic_one() {
    let folder = Folder::new();
    let scara = "name = \"scara\"\nconvention = \"dh\"\n\
        [[joint]]\nname = \"j1\"\nkind = \"revolute\"\nlimits_deg = [-150, 150]\na_m = 0.4\nd_m = 0.3\nalpha_deg = 0\n\
        [[joint]]\nname = \"j2\"\nkind = \"revolute\"\nlimits_deg = [-150, 150]\na_m = 0.35\nd_m = 0\nalpha_deg = 180\n\
        [[joint]]\nname = \"j3\"\nkind = \"prismatic\"\nlimits_mm = [0, 200]\na_m = 0\nd_m = 0.1\nalpha_deg = 0\n\
        [[joint]]\nname = \"j4\"\nkind = \"revolute\"\nlimits_deg = [-180, 180]\na_m = 0\nd_m = 0.05\nalpha_deg = 0\n";
    folder.write("scara.toml", scara);
    let line = "simulate --robot scara.toml --poses 60 --test-sets 1 --test-poses 30 --out cell";
    folder.run(line).ok();
    let line = "compare --robot scara.toml cell/train.csv --test cell/test1.csv --folds 3 --json -";
    let document = folder.run(line).ok().json();
    assert!(mean(&document, "poe") < mean(&document, "base-tool"));
}
