//! Plans: the chosen poses, the constraints of a cell, the written files, and what is refused.

use poegp_calibration::robot::{LoadOptions, Robot};

use crate::program::{Folder, SERIAL};
use crate::texts::texts;

/// Returns the rows of a plan as numbers.
fn rows(csv: &str) -> Vec<Vec<f64>> {
    csv.lines()
        .filter(|line| !line.starts_with('#'))
        .skip(1)
        .map(|line| line.split(',').map(|x| x.parse().unwrap()).collect())
        .collect()
}

/// A cell in which an arm of this size still has possible poses.
const CELL: &str = r#"
[[joint]]
name = "joint_1"
range_deg = [-60, 45]

[target]
origin = { xyz_mm = [30, 0, 150] }

[workspace]
min_mm = [0, -1500, 300]
max_mm = [2300, 1500, 2500]

[[keep_out]]
name = "table"
min_mm = [600, -300, 0]
max_mm = [1500, 300, 800]

[line_of_sight]
instrument_mm = [4000, 500, 1500]
normal = [0, 0, 1]
max_angle_deg = 60
"#;

/// Returns the target at joints in degrees, by plain trigonometry with the nominal links of the IRB 4400.
fn irb4400_target(q: &[f64], tool: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    type M = [[f64; 3]; 3];
    let rotation = |axis: usize, degrees: f64| -> M {
        let (s, c) = degrees.to_radians().sin_cos();
        match axis {
            0 => [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
            1 => [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
            _ => [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
        }
    };
    let apply = |m: &M, v: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|i| (0..3).map(|k| m[i][k] * v[k]).sum())
    };
    let product = |a: &M, b: &M| -> M {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
    };
    let steps: [(usize, [f64; 3]); 6] = [
        (2, [0.0, 0.0, 0.0]),
        (1, [0.2, 0.0, 0.68]),
        (1, [0.0, 0.0, 0.89]),
        (0, [0.0, 0.0, 0.15]),
        (1, [0.88, 0.0, 0.0]),
        (0, [0.0, 0.0, 0.0]),
    ];
    let mut at = [0.0; 3];
    let mut turned = rotation(2, 0.0);
    for ((axis, offset), angle) in steps.into_iter().zip(q) {
        let moved = apply(&turned, offset);
        at = std::array::from_fn(|i| at[i] + moved[i]);
        turned = product(&turned, &rotation(axis, *angle));
    }
    let moved = apply(&turned, [0.14, 0.0, 0.0]);
    at = std::array::from_fn(|i| at[i] + moved[i]);
    turned = product(&turned, &rotation(1, 90.0));
    let moved = apply(&turned, tool);
    (
        std::array::from_fn(|i| at[i] + moved[i]),
        apply(&turned, [0.0, 0.0, 1.0]),
    )
}

#[test]
fn a_plan_keeps_to_the_limits_and_spreads_over_the_payloads() {
    let _texts = texts();
    let folder = Folder::new();
    let line = format!(
        "plan --robot {SERIAL} --count 32 --payloads 5,0,10 --out plan.csv --test-poses 6 --test-out check.csv \
         --v-optimal --no-forecast --json plan.json"
    );
    folder.run(&line).ok().said();
    let robot = Robot::load(SERIAL, &LoadOptions::default()).unwrap();
    let (plan, check) = (
        rows(&folder.text("plan.csv")),
        rows(&folder.text("check.csv")),
    );
    assert_eq!((plan.len(), check.len()), (32, 6));
    for row in plan.iter().chain(&check) {
        for (q, joint) in row[1..].iter().zip(&robot.joints) {
            let (lower, upper) = joint.limits.unwrap();
            assert!(
                (lower..=upper).contains(&q.to_radians()) && q.abs() <= 180.0,
                "{row:?}"
            );
        }
    }
    // One block for each payload, as equal in size as possible.
    let payloads: Vec<f64> = plan.iter().map(|r| r[0]).collect();
    assert!(payloads.is_sorted(), "{payloads:?}");
    for kg in [0.0, 5.0, 10.0] {
        let count = payloads.iter().filter(|p| **p == kg).count();
        assert!((10..=11).contains(&count), "{kg}: {count}");
        assert_eq!(check.iter().filter(|r| r[0] == kg).count(), 2);
    }
    assert!(check.iter().all(|c| plan.iter().all(|p| p[1..] != c[1..])));
    let json = folder.json("plan.json");
    assert_eq!(json["poses"], 32);
    assert_eq!(json["strategy"], "V-optimal");
    assert!(json["forecast"].is_null());
    let many =
        format!("plan --robot {SERIAL} --count 60 --payloads 5 --out many.csv --no-forecast");
    folder.run(&many).ok().said();
}

#[test]
fn the_same_seed_makes_the_same_plan() {
    let folder = Folder::new();
    let plan = |out: &str, seed: u64| {
        let line = format!("plan --robot ur10 --count 16 --seed {seed} --out {out} --no-forecast");
        folder.run(&line).ok();
        folder.text(out)
    };
    let first = plan("a.csv", 4);
    assert_eq!(first, plan("b.csv", 4));
    assert_ne!(first, plan("c.csv", 5));
    assert!(
        first.contains("\nq1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n"),
        "{first}"
    );
}

/// Every pose is allowed by the cell, according to kinematics other than the program's.
#[test]
fn a_plan_keeps_to_what_the_cell_allows() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("cell.toml", CELL);
    let line = format!(
        "plan --robot {SERIAL} --constraints cell.toml --count 45 --payloads 0,5 --out plan.csv --no-forecast"
    );
    folder.run(&line).ok().said();
    for row in rows(&folder.text("plan.csv")) {
        let (at, normal) = irb4400_target(&row[1..], [0.03, 0.0, 0.15]);
        assert!((-60.0..=45.0).contains(&row[1]), "{row:?}");
        let workspace = [(0.0, 2.3), (-1.5, 1.5), (0.3, 2.5)];
        assert!(
            (0..3).all(|i| (workspace[i].0..=workspace[i].1).contains(&at[i])),
            "{at:?}"
        );
        let table = [(0.6, 1.5), (-0.3, 0.3), (0.0, 0.8)];
        assert!(
            !(0..3).all(|i| (table[i].0..=table[i].1).contains(&at[i])),
            "{at:?}"
        );
        let to: [f64; 3] = std::array::from_fn(|i| [4.0, 0.5, 1.5][i] - at[i]);
        let length = to.iter().map(|x| x * x).sum::<f64>().sqrt();
        let cosine = (0..3).map(|i| to[i] * normal[i]).sum::<f64>() / length;
        assert!(cosine.acos().to_degrees() <= 60.0, "{row:?}: {cosine}");
    }
}

#[test]
fn a_cell_that_allows_too_little_is_told_what_takes_most() {
    let _texts = texts();
    let folder = Folder::new();
    let tight = CELL.replace("max_angle_deg = 60", "max_angle_deg = 0.5");
    folder.write("cell.toml", &tight);
    let line = format!(
        "plan --robot {SERIAL} --constraints cell.toml --count 50 --out plan.csv --no-forecast"
    );
    folder.refuses(line);
}

/// For cells that reject every pose, the message names what would free some: one constraint, two, a joint range, or the radius.
#[test]
fn a_cell_that_rejects_everything_says_what_would_free_it() {
    let _texts = texts();
    let folder = Folder::new();
    let line = format!(
        "plan --robot {SERIAL} --constraints cell.toml --count 50 --out plan.csv --no-forecast"
    );
    let below = "[workspace]\nmin_mm = [0, -1500, -900]\nmax_mm = [2500, 1500, -300]\n";
    let nowhere = "[[keep_out]]\nname = \"hall\"\nmin_mm = [-5000, -5000, -5000]\nmax_mm = [5000, 5000, 5000]\n\
        [line_of_sight]\ninstrument_mm = [4000, 0, 1500]\nnormal = [0, 0, 1]\nmax_angle_deg = 0.001\n";
    let narrow = "[[joint]]\nname = \"joint_2\"\nrange_deg = [90, 96]\n\
        [workspace]\nmin_mm = [0, -1500, 2000]\nmax_mm = [2500, 1500, 2500]\n";
    for (text, said) in [
        (
            below,
            &["by floor", "more without workspace", "more without floor"][..],
        ),
        (
            nowhere,
            &[
                "a single constraint would allow none",
                "without keep_out \"hall\" and line_of_sight",
            ],
        ),
        (narrow, &["without the range of joint \"joint_2\""]),
    ] {
        folder.write("cell.toml", text);
        let refused = folder.refuses(&line);
        for part in said {
            assert!(refused.stderr.contains(part), "{part}: {refused:?}");
        }
    }
    // The named constraint is the cause: without it the same cell has a plan.
    folder.write("cell.toml", format!("floor = false\n{below}"));
    folder.run(&line).ok();
}

/// The radius of the links is reported with its origin, and it is in the JSON.
#[test]
fn a_plan_says_which_links_it_kept_apart() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("cell.toml", "link_radius_mm = 45\nfloor = false\n");
    let line = "plan --count 16 --payloads 0,2 --out plan.csv --no-forecast --json plan.json";
    for (arguments, radii, from, floor) in [
        ("--robot abb-irb120", [57.12; 2], "reach", Some(0.0)),
        ("--robot ur10", [80.0, 50.0], "description", Some(0.0)),
        (
            "--robot ur10 --constraints cell.toml",
            [45.0; 2],
            "constraints",
            None,
        ),
    ] {
        folder.run(&format!("{line} {arguments}")).ok().said();
        std::fs::remove_file(folder.path("plan.csv")).unwrap();
        let json = folder.json("plan.json");
        let all = json["links"]["radii_mm"].as_array().unwrap();
        assert_eq!(
            [all[0].as_f64(), all[7].as_f64()],
            radii.map(Some),
            "{json}"
        );
        assert_eq!(json["links"]["radius_from"], from);
        assert_eq!(json["floor_mm"].as_f64(), floor);
        let removed = json["configurations"]["removed"].as_array().unwrap();
        for rule in removed {
            assert!(
                rule["alone"].as_u64() <= rule["configurations"].as_u64(),
                "{rule}"
            );
        }
        assert!(json["prior"].is_null());
    }
}

/// The model of another arm changes a V-optimal plan; the model of another type of robot is refused.
#[test]
fn a_plan_takes_its_prior_from_a_sister_robot() {
    let _texts = texts();
    let folder = Folder::new();
    folder
        .run(&format!(
            "simulate --robot {SERIAL} --poses 60 --test-sets 1 --test-poses 20 --out arm"
        ))
        .ok();
    for (method, blob) in [("elastic", "elastic.blob"), ("base-tool", "base.blob")] {
        folder
            .run(&format!(
                "calibrate --robot {SERIAL} arm/train.csv --method {method} --accept readout --accept model --out {blob}"
            ))
            .ok();
    }
    let line = format!("plan --robot {SERIAL} --count 16 --payloads 0,5 --no-forecast");
    folder.run(&format!("{line} --out usual.csv")).ok();
    folder
        .run(&format!(
            "{line} --prior elastic.blob --out sister.csv --json plan.json"
        ))
        .ok()
        .said();
    assert_ne!(folder.text("usual.csv"), folder.text("sister.csv"));
    let prior = &folder.json("plan.json")["prior"];
    assert_eq!(prior["elastic"], true, "{prior}");
    // The frames of the simulated arms are 0.78 mm and mrad off.
    for key in ["frames_mm", "frames_mrad"] {
        assert!(
            (0.3..1.6).contains(&prior[key].as_f64().unwrap()),
            "{prior}"
        );
    }
    folder
        .run(&format!(
            "{line} --prior base.blob --out base.csv --json base.json"
        ))
        .ok()
        .said();
    assert_eq!(folder.json("base.json")["prior"]["elastic"], false);
    for arguments in [
        "--robot kuka-iiwa7 --count 30 --prior elastic.blob",
        "--robot ur10 --count 30 --prior elastic.blob",
        "--robot abb-irb4400 --count 30 --prior elastic.blob",
        "--robot abb-irb4400-serial --count 100 --prior elastic.blob",
        "--robot abb-irb4400-serial --count 30 --prior sister.csv",
        "--robot abb-irb4400-serial --count 30 --prior elastic.blob --space-filling",
    ] {
        folder.refuses(format!("plan {arguments} --out other.csv --no-forecast"));
    }
}

#[test]
fn constraints_that_cannot_be_meant_are_refused_with_their_line() {
    let _texts = texts();
    let folder = Folder::new();
    let line = format!(
        "plan --robot {SERIAL} --constraints cell.toml --count 50 --out plan.csv --no-forecast"
    );
    for text in [
        "[workspace]\nmin_mm = [0, 0, 0]\n",
        "[workspace]\nmin_mm = [0, 0, 9]\nmax_mm = [1, 1, 8]\n",
        "[[joint]]\nname = \"elbow\"\nrange_deg = [0, 1]\n",
        "[[joint]]\nname = \"joint_2\"\nrange_deg = [-90, 0]\n",
        "[[joint]]\nname = \"joint_2\"\nrange_mm = [-90, 0]\n",
        "[[joint]]\nname = \"joint_2\"\nrange_deg = [5, -5]\n",
        "[line_of_sight]\ninstrument_mm = [1, 2, 3]\nnormal = [0, 0, 0]\nmax_angle_deg = 30\n",
        "[line_of_sight]\ninstrument_mm = [1, 2, 3]\nnormal = [0, 0, 1]\nmax_angle_deg = 0\n",
        "[instrument]\n",
        "floor_mm = true\n",
        "floor = true\nfloor_m = 1\n",
        "link_radius_mm = -3\n",
        "workspace = 3\n",
        "[workspace]\nmin_mm = [0, 0, 0]\nmin_m = [0, 0, 0]\nmax_mm = [1, 1, 8]\n",
    ] {
        folder.write("cell.toml", text);
        folder.refuses(&line);
    }
    folder.refuses(line.replace("cell.toml", "none.toml"));
}

#[test]
fn what_cannot_be_planned_is_refused() {
    let _texts = texts();
    let folder = Folder::new();
    for line in [
        "--robot ur10 --count 5",
        "--robot ur10 --payloads 1,-2",
        "--robot ur10 --payloads 1,5,1",
        "--robot ur10 --v-optimal --space-filling",
        "--robot ur10 --test-poses 5",
        "--robot kuka-iiwa7 --krl a.src",
        "--robot ur10 --rapid plan.csv",
    ] {
        folder.refuses(format!("plan {line} --out plan.csv --no-forecast"));
    }
}

/// The robot programs have the joints of the CSV file, to the last digit.
#[test]
fn programs_and_table_have_the_same_joints() {
    let folder = Folder::new();
    let line = "plan --robot abb-irb120 --count 30 --payloads 0,1 --out plan.csv --rapid p.mod --krl p.src --fanuc p.ls \
                --urscript p.script --no-forecast";
    folder.run(line).ok();
    let csv = folder.text("plan.csv");
    let [rapid, krl, fanuc, urscript] =
        ["p.mod", "p.src", "p.ls", "p.script"].map(|name| folder.text(name));
    for (number, line) in (1..).zip(
        csv.lines()
            .filter(|l| l.starts_with("0,") || l.starts_with("1,")),
    ) {
        let joints: Vec<&str> = line.split(',').skip(1).collect();
        assert!(
            rapid.contains(&format!("[[{}],", joints.join(","))),
            "{line}"
        );
        let axes: Vec<String> = (1..)
            .zip(&joints)
            .map(|(i, q): (usize, _)| format!("A{i} {q}"))
            .collect();
        assert!(krl.contains(&format!("{{{}}}", axes.join(","))), "{line}");
        let position = fanuc.split(&format!("P[{number}]{{")).nth(1).unwrap();
        let position = position.split('}').next().unwrap();
        assert!(
            joints
                .iter()
                .all(|q| position.contains(&format!(" {q} deg"))),
            "{position}"
        );
        let radians: Vec<String> = joints
            .iter()
            .map(|q| format!("{:.9}", q.parse::<f64>().unwrap().to_radians()))
            .collect();
        assert!(
            urscript.contains(&format!("movej([{}]", radians.join(", "))),
            "{line}"
        );
    }
    assert_eq!(rapid.matches("MoveAbsJ").count(), 30);
    assert_eq!(krl.matches("PTP {").count(), 30);
    assert_eq!(fanuc.matches("FINE").count(), 30);
    assert_eq!(urscript.matches("movej(").count(), 30);
    // The program stops for the operator before each of the two payloads.
    assert_eq!(
        (rapid.matches("Stop;").count(), krl.matches("HALT").count()),
        (2, 2)
    );
    assert_eq!(
        (
            fanuc.matches("PAUSE").count(),
            urscript.matches("popup(").count()
        ),
        (2, 2)
    );
}

/// A plan with measured poses added is a measurement file.
#[test]
fn a_plan_with_poses_added_calibrates() {
    let folder = Folder::new();
    let line =
        format!("plan --robot {SERIAL} --count 30 --payloads 0,5 --out plan.csv --no-forecast");
    folder.run(&line).ok();
    let mut measured = String::new();
    for line in folder.text("plan.csv").lines() {
        measured += line;
        if line.starts_with("payload_kg") {
            measured += ",x_mm,y_mm,z_mm";
        } else if !line.starts_with('#') {
            let joints: Vec<f64> = line
                .split(',')
                .skip(1)
                .map(|x| x.parse().unwrap())
                .collect();
            let (at, _) = irb4400_target(&joints, [0.05, 0.0, 0.1]);
            measured += &format!(",{:.4},{:.4},{:.4}", 1e3 * at[0], 1e3 * at[1], 1e3 * at[2]);
        }
        measured.push('\n');
    }
    folder.write("measured.csv", measured);
    let line = format!(
        "calibrate --robot {SERIAL} measured.csv --method base-tool --accept readout --out arm.blob --json -"
    );
    let json = folder.run(&line).ok().json();
    assert_eq!(json["training_poses"], 30);
    // The poses come from the description's own kinematics, so only the last digit of the file remains.
    assert!(
        json["training"]["position_mm"]["max"].as_f64().unwrap() < 2e-3,
        "{json}"
    );
}

#[test]
fn a_forecast_says_what_more_poses_are_worth() {
    let _texts = texts();
    let folder = Folder::new();
    let line = format!(
        "plan --robot {SERIAL} --count 16 --payloads 0,5 --out plan.csv --forecast 30 --json plan.json"
    );
    folder.run(&line).ok().said();
    let json = folder.json("plan.json");
    let rows = json["forecast"]["rows"].as_array().unwrap();
    let poses: Vec<u64> = rows.iter().map(|r| r["poses"].as_u64().unwrap()).collect();
    assert_eq!(poses, [16, 30]);
    for row in rows {
        for error in ["paper_mm", "wild_mm"] {
            // Noise alone makes 0.048.
            assert!((0.04..0.5).contains(&row[error].as_f64().unwrap()), "{row}");
        }
    }
}
