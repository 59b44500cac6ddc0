//! MJCF and Craig's rows, computed with other formulas than the program's: unit quaternions and 4 × 4 matrices.
//! `tests/peers/exports/run` reads them with MuJoCo and Python.

use nalgebra::{Matrix4, Quaternion, Rotation3, UnitQuaternion, Vector3};
use poegp_calibration::robot::{LoadOptions, Robot};
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use serde_json::{Map, Value, json};

use crate::export::{calibrated, chain};
use crate::program::Folder;

const ARMS: [&str; 5] = [
    "abb-irb4400",
    "kuka-iiwa7",
    "ur5",
    "workbench.urdf",
    "no_tool0.urdf",
];

/// Returns joint values over the whole range.
fn joints(n: usize, k: i32) -> Vec<f64> {
    (0..n)
        .map(|i| 2.5 * (0.37 * f64::from(k * k) + 1.9 * i as f64).sin())
        .collect()
}

/// Returns the largest differences in metres and of rotation elements from the program's chain.
fn apart(folder: &Folder, forward: impl Fn(&[f64]) -> Matrix4<f64>) -> f64 {
    let chain = chain(folder).poe();
    let mut worst = 0.0_f64;
    for k in 0..200 {
        let q = joints(chain.kinds().len(), k);
        let (ours, theirs) = (chain.forward(&q), forward(&q));
        for i in 0..3 {
            worst = worst.max((ours.translation[i] - theirs[(i, 3)]).abs());
            for j in 0..3 {
                worst = worst.max((ours.rotation[(i, j)] - theirs[(i, j)]).abs());
            }
        }
    }
    worst
}

fn numbers(tag: &BytesStart<'_>, key: &str) -> Option<Vec<f64>> {
    let text = text(tag, key)?;
    Some(text.split(' ').map(|x| x.parse().unwrap()).collect())
}

fn text(tag: &BytesStart<'_>, key: &str) -> Option<String> {
    let found = tag.try_get_attribute(key).unwrap()?;
    Some(found.unescape_value().unwrap().into_owned())
}

/// Returns the frame of `pos` and `quat` as MuJoCo's documentation defines them: the frame in that of its parent, scalar
/// first.
fn frame(tag: &BytesStart<'_>) -> Matrix4<f64> {
    let (pos, quat) = (numbers(tag, "pos").unwrap(), numbers(tag, "quat").unwrap());
    let quaternion = Quaternion::new(quat[0], quat[1], quat[2], quat[3]);
    assert!((quaternion.norm() - 1.0).abs() < 1e-14);
    UnitQuaternion::from_quaternion(quaternion)
        .to_homogeneous()
        .append_translation(&Vector3::from_row_slice(&pos))
}

#[derive(Debug)]
enum Element {
    Frame(Matrix4<f64>),
    /// Revolute if true, otherwise prismatic.
    Joint(bool),
}

/// An MJCF file: the elements that lead to each site, names and ranges of the joints, and bodies without mass.
#[derive(Default)]
struct Mjcf {
    sites: Vec<(String, Vec<Matrix4<f64>>)>,
    path: Vec<Element>,
    joints: Vec<(String, Option<Vec<f64>>)>,
    masses: usize,
    depth: usize,
}

impl Mjcf {
    fn read(text: &str) -> Self {
        let mut out = Self::default();
        let mut reader = Reader::from_str(text);
        loop {
            match reader.read_event().unwrap() {
                Event::Eof => break,
                Event::Start(tag) if tag.name().as_ref() == b"body" => {
                    out.depth += 1;
                    // The first body is the base, which stands in the world.
                    if out.depth > 1 {
                        out.path.push(Element::Frame(frame(&tag)));
                    }
                }
                Event::Empty(tag) => out.element(&tag),
                _ => {}
            }
        }
        out
    }

    fn element(&mut self, tag: &BytesStart<'_>) {
        match tag.name().as_ref() {
            b"joint" => {
                assert_eq!(numbers(tag, "axis").unwrap(), [0.0, 0.0, 1.0]);
                let turns = match text(tag, "type").unwrap().as_str() {
                    "hinge" => true,
                    "slide" => false,
                    other => panic!("{other}"),
                };
                self.path.push(Element::Joint(turns));
                self.joints
                    .push((text(tag, "name").unwrap(), numbers(tag, "range")));
            }
            b"inertial" => {
                // MuJoCo refuses a mass or inertia below mjMINVAL.
                assert!(numbers(tag, "mass").unwrap()[0] > 1e-15);
                let inertia = numbers(tag, "diaginertia").unwrap();
                assert!(inertia.len() == 3 && inertia.iter().all(|i| *i > 1e-15));
                self.masses += 1;
            }
            b"site" => self
                .sites
                .push((text(tag, "name").unwrap(), vec![frame(tag)])),
            b"compiler" => assert_eq!(text(tag, "angle").unwrap(), "radian"),
            other => panic!("{}", String::from_utf8_lossy(other)),
        }
    }

    fn forward(&self, site: &str, q: &[f64]) -> Matrix4<f64> {
        let mut values = q.iter();
        let along = self.path.iter().map(|element| match element {
            Element::Frame(frame) => *frame,
            Element::Joint(true) => {
                Rotation3::from_axis_angle(&Vector3::z_axis(), *values.next().unwrap())
                    .to_homogeneous()
            }
            Element::Joint(false) => {
                Matrix4::new_translation(&Vector3::new(0.0, 0.0, *values.next().unwrap()))
            }
        });
        let body: Matrix4<f64> = along.product();
        let (_, frames) = self.sites.iter().find(|(name, _)| name == site).unwrap();
        frames.iter().fold(body, |pose, frame| pose * frame)
    }
}

#[test]
fn mjcf_has_the_poses_of_the_chain_and_the_joints_of_the_arm() {
    for robot in ARMS {
        let folder = calibrated(robot, "poe");
        let nominal = match robot.ends_with(".urdf") {
            true => format!("--urdf {robot} --out new.urdf"),
            false => String::new(),
        };
        folder
            .run(&format!("export arm.blob {nominal} --mjcf arm.xml"))
            .ok();
        let text = folder.text("arm.xml");
        for part in [
            "small placeholders, because MuJoCo requires them",
            "distance ",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let mjcf = Mjcf::read(&text);
        let chain = chain(&folder);
        let n = chain.joints.len();
        assert_eq!((mjcf.masses, mjcf.depth, mjcf.joints.len()), (n, n + 1, n));
        let worst = apart(&folder, |q| mjcf.forward("target", q));
        assert!(worst < 1e-13, "{robot}: {worst:e}");
        let tool = chain.flange_from_target;
        let target = tool.rotation.to_homogeneous();
        let target = target.append_translation(&tool.translation);
        let worst = apart(&folder, |q| mjcf.forward("tool0", q) * target);
        assert!(worst < 1e-13, "{robot}: {worst:e}");
        let is_coupled = robot == "abb-irb4400";
        let mut limited = 0;
        for (joint, (name, range)) in chain.joints.iter().zip(&mjcf.joints) {
            // The blob has no names; these come from the URDF.
            if !nominal.is_empty() || !robot.ends_with(".urdf") {
                assert!(!name.is_empty());
            }
            limited += usize::from(range.is_some());
            if let (Some((lower, upper)), Some(range)) = (joint.limits, range) {
                assert!((range[0] - lower).abs() < 1e-6 && (range[1] - upper).abs() < 1e-6);
            }
        }
        // The third joint is moved by two joints of the controller, whose limits are no limits of it.
        let said = text.contains("not in this file: ") && text.contains("(joint_3)");
        assert!(!is_coupled || said, "{text}");
        let expected = chain.joints.iter().filter(|j| j.limits.is_some()).count();
        assert_eq!(limited + usize::from(is_coupled), expected, "{robot}");
    }
    let folder = calibrated("workbench.urdf", "poe");
    folder
        .run("export arm.blob --urdf workbench.urdf --out new.urdf --mjcf arm.xml")
        .ok();
    let names: Vec<String> = Mjcf::read(&folder.text("arm.xml"))
        .joints
        .into_iter()
        .map(|(name, _)| name)
        .collect();
    assert_eq!(names[..3], ["turn", "lift", "bend"]);
}

/// Four joints, each moved by one joint of the controller: as it is, reversed, doubled and halved.
const GEARED: &str = r#"name = "geared"
convention = "dh"
coupling = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 2, 0], [0, 0, 0, 0.5]]
joint = [
    { name = "a", kind = "revolute", limits_deg = [-170, 170], a_mm = 25, d_mm = 400, alpha_deg = -90 },
    { name = "b", kind = "revolute", limits_deg = [-10, 90], a_mm = 315, d_mm = 0, alpha_deg = 0 },
    { name = "c", kind = "revolute", limits_deg = [-110, 100], a_mm = 35, d_mm = 0, alpha_deg = -90 },
    { name = "d", kind = "revolute", limits_deg = [-180, 180], a_mm = 0, d_mm = 365, alpha_deg = 0 },
]
"#;

/// A file of links and joints has the joints of the chain, and their limits are those of the chain.
#[test]
fn limits_are_those_of_the_joints_of_the_chain() {
    let folder = Folder::new();
    folder.write("geared.toml", GEARED);
    let commands = "simulate --robot geared.toml --poses 30 --test-sets 0 --seed 5 --out cell\n\
        calibrate --robot geared.toml cell/train.csv --method poe --out arm.blob\n\
        export arm.blob --out arm.urdf --mjcf arm.xml";
    for line in commands.lines() {
        folder.run(line.trim()).ok();
    }
    let wanted = [
        (-170.0, 170.0),
        (-90.0, 10.0),
        (-220.0, 200.0),
        (-90.0, 90.0),
    ];
    let options = LoadOptions {
        base: None,
        tip: Some("tool0".to_owned()),
    };
    let urdf = Robot::load(folder.path("arm.urdf").to_str().unwrap(), &options).unwrap();
    let mjcf = Mjcf::read(&folder.text("arm.xml"));
    for ((wanted, of_urdf), (_, of_mjcf)) in wanted.iter().zip(&urdf.joints).zip(&mjcf.joints) {
        let of_mjcf = of_mjcf.as_ref().map(|range| (range[0], range[1]));
        for (lower, upper) in [of_urdf.limits.unwrap(), of_mjcf.unwrap()] {
            let off = (lower.to_degrees() - wanted.0).abs() + (upper.to_degrees() - wanted.1).abs();
            assert!(off < 1e-4, "{lower} {upper}, {wanted:?}");
        }
    }
    assert!(!folder.text("arm.urdf").contains("the limits of joints"));
}

fn rpy(pose: &Value) -> Matrix4<f64> {
    let three = |key: &str| [0, 1, 2].map(|i| pose[key][i].as_f64().unwrap());
    let [x, y, z] = three("rpy_rad");
    let turned = [
        (Vector3::z_axis(), z),
        (Vector3::y_axis(), y),
        (Vector3::x_axis(), x),
    ];
    let turned = turned
        .iter()
        .map(|(axis, angle)| Rotation3::from_axis_angle(axis, *angle))
        .fold(Rotation3::identity(), |all, one| all * one);
    turned
        .to_homogeneous()
        .append_translation(&Vector3::from(three("xyz_m")))
}

/// Returns the matrix of a row by Craig, "Introduction to Robotics", eq. 3.6, with β about the y axis that a and α lead to.
fn craig(joint: &Value, q: f64) -> Matrix4<f64> {
    let number = |key: &str| joint[key].as_f64().unwrap_or(0.0);
    let along = joint["kind"] == "prismatic";
    let theta = number("theta_offset_rad") + if along { 0.0 } else { q };
    let d = number("d_m") + if along { q } else { 0.0 };
    let (sa, ca) = number("alpha_rad").sin_cos();
    let (sb, cb) = number("beta_rad").sin_cos();
    let (st, ct) = theta.sin_cos();
    #[rustfmt::skip]
    let before = Matrix4::new(
        1.0, 0.0, 0.0, number("a_m"),
        0.0,  ca, -sa, 0.0,
        0.0,  sa,  ca, 0.0,
        0.0, 0.0, 0.0, 1.0,
    );
    #[rustfmt::skip]
    let hayati = Matrix4::new(
         cb, 0.0,  sb, 0.0,
        0.0, 1.0, 0.0, 0.0,
        -sb, 0.0,  cb, 0.0,
        0.0, 0.0, 0.0, 1.0,
    );
    #[rustfmt::skip]
    let behind = Matrix4::new(
         ct, -st, 0.0, 0.0,
         st,  ct, 0.0, 0.0,
        0.0, 0.0, 1.0,   d,
        0.0, 0.0, 0.0, 1.0,
    );
    before * hayati * behind
}

#[test]
fn craigs_rows_have_the_poses_of_the_chain() {
    for robot in ARMS {
        let folder = calibrated(robot, "poe");
        folder.run("export arm.blob --mdh mdh.json").ok();
        let table = folder.json("mdh.json");
        assert_eq!(table["convention"], "modified-dh");
        let rows = table["joints"].as_array().unwrap();
        let first = ["a_m", "alpha_rad"].map(|key| rows[0][key].as_f64().unwrap());
        assert_eq!(first, [0.0; 2], "{robot}");
        let parallel = rows.iter().filter(|row| row.get("beta_rad").is_some());
        assert!(robot != "ur5" || parallel.count() == 2, "{table:#}");
        let worst = apart(&folder, |q| {
            let arm: Matrix4<f64> = rows.iter().zip(q).map(|(row, q)| craig(row, *q)).product();
            let ends = [&table["flange"]["origin"], &table["flange_from_target"]].map(rpy);
            rpy(&table["base"]["origin"]) * arm * ends[0] * ends[1]
        });
        assert!(worst < 1e-12, "{robot}: {worst:e}");
    }
}

/// Returns a CSV file with its rows by column name, and its comments.
fn rows(folder: &Folder, file: &str) -> (Vec<Map<String, Value>>, String) {
    let text = folder.text(file);
    let comments: Vec<&str> = text.lines().filter(|line| line.starts_with('#')).collect();
    let mut reader = csv::ReaderBuilder::new();
    let mut reader = reader.comment(Some(b'#')).from_reader(text.as_bytes());
    let header = reader.headers().unwrap().clone();
    let row = |record: csv::StringRecord| {
        let field = |(name, field): (&str, &str)| {
            let value = match field.parse::<f64>() {
                Ok(number) => number.into(),
                Err(_) if field.is_empty() => return None,
                Err(_) => field.into(),
            };
            Some((name.to_owned(), value))
        };
        header.iter().zip(&record).filter_map(field).collect()
    };
    let rows = reader.records().map(|record| row(record.unwrap()));
    (rows.collect(), comments.join("\n"))
}

/// Returns the frame of a row: `x_m` to `yaw_rad`.
fn origin(row: &Map<String, Value>) -> Matrix4<f64> {
    let three = |names: [&str; 3]| json!(names.map(|name| row[name].as_f64().unwrap()));
    rpy(&json!({
        "xyz_m": three(["x_m", "y_m", "z_m"]),
        "rpy_rad": three(["roll_rad", "pitch_rad", "yaw_rad"]),
    }))
}

/// The matrix of a row at a joint value.
type Motion = dyn Fn(&Value, f64) -> Matrix4<f64>;

/// Returns the matrix of a distal row: θ and d come first, whereas in Craig's rows they come last.
fn distal(joint: &Value, q: f64) -> Matrix4<f64> {
    let mut own = joint.clone();
    let mut before = joint.clone();
    for key in ["a_m", "alpha_rad", "beta_rad"] {
        own[key] = json!(0.0);
    }
    for key in ["theta_offset_rad", "d_m"] {
        before[key] = json!(0.0);
    }
    before["kind"] = json!("revolute");
    craig(&own, q) * craig(&before, 0.0)
}

#[test]
fn tables_as_csv_have_the_poses_of_the_chain_and_say_how_far_it_is() {
    for robot in ["abb-irb4400", "kuka-iiwa7", "ur5", "workbench.urdf"] {
        let folder = calibrated(robot, "poe");
        folder
            .run("export arm.blob --dh dh.csv --mdh mdh.csv --poe poe.csv --json all.json")
            .ok();
        let mean = &folder.json("all.json")["distance"]["chain"]["position_mm"]["mean"];
        let distance = format!("distance {:.3} mm on average", mean.as_f64().unwrap());
        let framed = |row: &Value, q: f64| {
            let moved = craig(&json!({"kind": row["kind"]}), q);
            origin(row.as_object().unwrap()) * moved
        };
        let tables: [(&str, &Motion); 3] = [
            ("dh.csv", &distal),
            ("mdh.csv", &craig),
            ("poe.csv", &framed),
        ];
        for (file, row) in tables {
            let (rows, comments) = rows(&folder, file);
            assert!(comments.contains(&distance), "{comments}");
            let named = |name: &str| rows.iter().find(|row| row["name"] == name).map(origin);
            let joints = rows.iter().filter(|row| row["kind"] != "fixed").cloned();
            let joints: Vec<Value> = joints.map(Value::Object).collect();
            let base = named("base").unwrap_or_else(Matrix4::identity);
            let ends = named("flange").unwrap() * named("flange_from_target").unwrap();
            let worst = apart(&folder, |q| {
                let arm: Matrix4<f64> = joints.iter().zip(q).map(|(own, q)| row(own, *q)).product();
                base * arm * ends
            });
            assert!(worst < 1e-12, "{robot} {file}: {worst:e}");
            let instrument = named("instrument_from_base").unwrap();
            let stands = chain(&folder).instrument_from_base;
            let stands = Vector3::from_iterator(stands.translation.iter().copied());
            assert!((instrument.fixed_view::<3, 1>(0, 3) - stands).norm() < 1e-12);
            let coupling = joints[2].get("coupling_q2").map(|c| c.as_f64().unwrap());
            let expected = chain(&folder).coupling.map(|rows| rows[2][1]);
            assert_eq!(coupling, expected, "{robot}");
        }
    }
}

#[test]
fn the_kinematics_of_universal_robots_as_csv_end_at_the_target() {
    let folder = calibrated("ur5", "poe");
    folder.run("export arm.blob --ur-kinematics ur.csv").ok();
    let (rows, comments) = rows(&folder, "ur.csv");
    assert!(
        comments.contains("distance ") && comments.contains("TCP"),
        "{comments}"
    );
    let names: Vec<&str> = rows
        .iter()
        .map(|row| row["name"].as_str().unwrap())
        .collect();
    let links = [
        "shoulder",
        "upper_arm",
        "forearm",
        "wrist_1",
        "wrist_2",
        "wrist_3",
    ];
    assert_eq!((&names[..6], names[6]), (&links[..], "tool0_from_target"));
    let worst = apart(&folder, |q| {
        let turned = q.iter().map(|q| craig(&json!({"kind": "revolute"}), *q));
        let links = rows
            .iter()
            .zip(turned)
            .map(|(row, turned)| origin(row) * turned);
        links.product::<Matrix4<f64>>() * origin(&rows[6])
    });
    assert!(worst < 1e-12, "{worst:e}");
}
