//! Kinematics of the three descriptions against each other and against the direct product; every refusal by its words.

mod rejected;
mod rejected_urdf;

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::robot::{
    BUILT_IN, LoadOptions, Robot, normal_form as chain, toml_description as description, urdf,
};

const ROBOTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/robots");

fn urdf_text(name: &str) -> String {
    // The public files round a quarter turn to nine digits.
    let text = std::fs::read_to_string(format!("{ROBOTS}/{name}.urdf")).unwrap();
    text.replace("1.57079633", "1.5707963267948966")
}

fn load(spec: &str) -> Robot {
    Robot::load(spec, &LoadOptions::default()).unwrap()
}

fn from_toml(text: &str) -> Robot {
    description::parse(Path::new("robot.toml"), text).unwrap()
}

fn random_joints(rng: &mut ChaCha8Rng, n: usize) -> Vec<f64> {
    (0..n).map(|_| rng.random_range(-3.0..3.0)).collect()
}

#[track_caller]
fn assert_close(a: &Pose<f64>, b: &Pose<f64>, tolerance: f64) {
    for (x, y) in a.to_rows().iter().zip(b.to_rows()) {
        assert!((x - y).abs() <= tolerance, "{a:?} {b:?}");
    }
}

#[test]
fn built_in_and_urdf_agree() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (built_in, file) in [
        ("abb-irb4400-serial", "abb_irb4400_60"),
        ("abb-irb120", "abb_irb120_3_58"),
        ("kuka-iiwa7", "kuka_lbr_iiwa7_r800"),
    ] {
        let a = load(built_in);
        let b = urdf::parse(Path::new(file), &urdf_text(file), &LoadOptions::default()).unwrap();
        assert_eq!(a.joints.len(), b.joints.len());
        for (p, q) in a.joints.iter().zip(&b.joints) {
            assert_eq!((&p.name, p.kind), (&q.name, q.kind));
            let ((p_low, p_high), (q_low, q_high)) = (p.limits.unwrap(), q.limits.unwrap());
            assert!(
                (p_low - q_low).abs() < 1e-5 && (p_high - q_high).abs() < 1e-5,
                "{}",
                p.name
            );
        }
        for _ in 0..100 {
            let q = random_joints(&mut rng, a.joints.len());
            assert_close(&a.forward(&q), &b.forward(&q), 1e-12);
        }
        // The file as it is, through the path.
        let c = load(&format!("{ROBOTS}/{file}.urdf"));
        let q = random_joints(&mut rng, a.joints.len());
        assert_close(&a.forward(&q), &c.forward(&q), 1e-8);
    }
}

#[test]
fn every_built_in_loads() {
    for name in BUILT_IN {
        let robot = load(name);
        assert_eq!(robot.name, name);
        assert_eq!(robot.parent_from_joint.len(), robot.joints.len() + 1);
        assert_eq!(robot.coupling.is_some(), name == "abb-irb4400");
        assert!(robot.joints.iter().all(|joint| joint.limits.is_some()));
    }
}

#[test]
fn coupling_maps_the_controllers_joints() {
    let (controller, serial) = (load("abb-irb4400"), load("abb-irb4400-serial"));
    let q = [0.3, -0.4, 0.5, -0.6, 0.7, -0.8];
    let mut chain = q;
    chain[2] = q[2] - q[1];
    assert_close(&controller.forward(&q), &serial.forward(&chain), 1e-15);
    assert_eq!(
        controller.coupling.unwrap()[2],
        [0.0, -1.0, 1.0, 0.0, 0.0, 0.0]
    );
}

/// The zero pose of the published DH parameters, from their closed form.
#[test]
fn universal_robots_zero_pose() {
    let at_zero = load("ur5").forward(&[0.0; 6]).translation;
    let expected = Vector3::new(-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465);
    assert!((at_zero - expected).norm() < 1e-15, "{at_zero}");
    let at_zero = load("ur10").forward(&[0.0; 6]).translation;
    let expected = Vector3::new(-0.612 - 0.5723, -0.163941 - 0.0922, 0.1273 - 0.1157);
    assert!((at_zero - expected).norm() < 1e-15, "{at_zero}");
}

/// Exp of a rotation or translation by `q` about or along a unit axis: not the way the normal form goes.
fn moved(kind: JointKind, axis: [f64; 3], q: f64) -> Pose<f64> {
    let axis = Vector3::from(axis).normalize() * q;
    let zero = Vector3::zeros();
    Pose::exp(&match kind {
        JointKind::Revolute => Twist {
            linear: zero,
            angular: axis,
        },
        JointKind::Prismatic => Twist {
            linear: axis,
            angular: zero,
        },
    })
}

#[test]
fn normal_form_is_the_direct_product() {
    let robot = load(&format!("{ROBOTS}/mixed.urdf"));
    let names: Vec<_> = robot
        .joints
        .iter()
        .map(|j| (j.name.as_str(), j.kind, j.limits))
        .collect();
    assert_eq!(
        names,
        [
            ("slide", JointKind::Prismatic, Some((-0.5, 1.5))),
            ("shoulder", JointKind::Revolute, Some((-2.0, 2.5))),
            ("roll", JointKind::Revolute, None),
        ]
    );
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..100 {
        let q = random_joints(&mut rng, 3);
        let direct = chain::origin([0.1, -0.2, 0.3], [0.4, -0.5, 0.6])
            * chain::origin([0.0, 0.05, 0.0], [0.1, 0.0, 0.0])
            * moved(JointKind::Prismatic, [0.0, -1.0, 0.0], q[0])
            * chain::origin([0.2, 0.0, 0.7], [0.0, 0.3, 0.0])
            * moved(JointKind::Revolute, [1.0, 2.0, -2.0], q[1])
            * chain::origin([0.4, 0.01, 0.0], [0.0, 0.0, -0.2])
            * moved(JointKind::Revolute, [0.0, 0.0, -1.0], q[2])
            * chain::origin([0.02, 0.03, 0.1], [0.0, std::f64::consts::FRAC_PI_2, 0.0]);
        assert_close(&robot.forward(&q), &direct, 1e-14);
    }
}

#[test]
fn normal_form_at_every_axis() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut axes = vec![
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
        [1e-9, 0.0, -1.0],
        [1.0, 0.0, 1e-12],
    ];
    axes.extend((0..50).map(|_| std::array::from_fn(|_| rng.random_range(-2.0..2.0))));
    for axis in axes {
        for kind in [JointKind::Revolute, JointKind::Prismatic] {
            let mut chain = chain::Chain::new();
            let joint = super::Joint {
                name: "j".into(),
                kind,
                limits: None,
                gear_lines: Vec::new(),
                link_radius: None,
            };
            chain.push_joint(joint, &Vector3::from(axis));
            let robot = chain.finish("one".into(), None).unwrap();
            let frame = robot.parent_from_joint[0].rotation;
            assert!((frame * frame.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-15);
            assert_close(&robot.forward(&[1.3]), &moved(kind, axis, 1.3), 1e-15);
        }
    }
}

/// Base, tip and the flange's names choose the chain.
#[test]
fn links_choose_the_chain() {
    let text = urdf_text("mixed");
    let chain = |base: Option<&str>, tip: Option<&str>| {
        let options = LoadOptions {
            base: base.map(Into::into),
            tip: tip.map(Into::into),
        };
        urdf::parse(Path::new("mixed.urdf"), &text, &options).unwrap()
    };
    let whole = chain(None, None);
    assert_eq!(whole, chain(Some("world"), Some("flange")));
    let part = chain(Some("carriage"), Some("camera"));
    assert_eq!(part.joints.len(), 1);
    assert_eq!(part.joints[0], whole.joints[1]);
    assert_eq!(chain(Some("carriage"), None).joints.len(), 2);
}

#[test]
fn conventions_describe_the_same_arm() {
    // A planar arm with a lift: the three conventions, and all units.
    let head = "name = \"scara\"\nconvention = ";
    let poe = from_toml(&format!(
        "{head}\"poe\"\n
        [[joint]]\nname = \"a\"\nkind = \"revolute\"\nlimits_deg = [-90, 90]\n
        origin = {{ xyz_m = [0, 0, 0.5], rpy_deg = [0, 0, 30] }}\naxis = [0, 0, 1]\n
        [[joint]]\nname = \"b\"\nkind = \"prismatic\"\nlimits_mm = [0, 250]\n
        origin = {{ xyz_mm = [400, 0, 0] }}\naxis = [0, 0, -1]\n
        [flange]\norigin = {{ xyz_m = [0, 0, -0.1], rpy_rad = [3.141592653589793, 0, 0] }}"
    ));
    let dh = from_toml(&format!(
        "{head}\"dh\"\n
        [[joint]]\nname = \"a\"\nkind = \"revolute\"\nlimits_rad = [-1.5707963267948966, 1.5707963267948966]\n
        a_mm = 400\nd_m = 0.5\nalpha_deg = 180\ntheta_offset_deg = 30\n
        [[joint]]\nname = \"b\"\nkind = \"prismatic\"\nlimits_m = [0, 0.25]\n
        a_m = 0\nd_mm = 100\nalpha_rad = 0"
    ));
    let modified = from_toml(&format!(
        "{head}\"modified-dh\"\n
        [base]\norigin = {{ xyz_m = [0, 0, 0.2] }}\n
        [[joint]]\nname = \"a\"\nkind = \"revolute\"\nlimits_deg = [-90, 90]\n
        a_m = 0\nd_m = 0.3\nalpha_deg = 0\ntheta_offset_rad = 0.5235987755982988\n
        [[joint]]\nname = \"b\"\nkind = \"prismatic\"\nlimits_m = [0, 0.25]\n
        a_m = 0.4\nd_m = 0.1\nalpha_deg = 180"
    ));
    assert_eq!(poe.joints, dh.joints);
    assert_eq!(poe.joints, modified.joints);
    for q in [[0.0, 0.0], [0.7, 0.2], [-1.1, 0.05]] {
        assert_close(&poe.forward(&q), &dh.forward(&q), 1e-15);
        assert_close(&poe.forward(&q), &modified.forward(&q), 1e-15);
    }
    let reach = poe.forward(&[0.0, 0.2]).translation;
    let angle = std::f64::consts::FRAC_PI_6;
    assert!(
        (reach - Vector3::new(0.4 * libm::cos(angle), 0.4 * libm::sin(angle), 0.2)).norm() < 1e-15
    );
}
