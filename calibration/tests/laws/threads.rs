//! No byte of a model and no held-out error depends on the number of threads.

use poegp_calibration::blob::write::calibrate_to_blob;
use poegp_calibration::measurement::sample::ToolName;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::progress::FitContext;
use poegp_calibration::validation::cross_validation::{Task, TestSet};
use poegp_calibration::validation::learning_curve::{curve, sizes};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::own_joint_curve::{Curves, anywhere, measured, robot};
use crate::{origin, task};

/// The set has an own-joint curve, payloads and two tools, so that the test covers every matrix and the paper's process.
#[test]
fn no_byte_depends_on_the_number_of_threads() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let curves = Curves::draw(6, 18, 3e-4, &mut random);
    let mut train = measured(&curves, 70, &mut random, anywhere);
    for (i, sample) in train.iter_mut().enumerate() {
        sample.payload_kg = Some([0.5, 2.0, 4.0][i % 3]);
    }
    let (robot, origin) = (robot(), origin(vec![ToolName::default()]));
    for method in [Method::Elastic, Method::PoeGpLoad] {
        let config = Config::new(method);
        let on = |threads: usize| {
            let context = FitContext::default().with_threads(threads);
            let found = calibrate_to_blob(&robot, &train, &config, &origin, &context).unwrap();
            let task = Task {
                threads,
                ..task(&robot, &train, &[], 3, &origin)
            };
            let held_out = task.held_out(&config, &mut || ()).unwrap();
            let errors: Vec<u64> = held_out.iter().map(|e| e.position_mm.to_bits()).collect();
            let curve = found
                .calibration
                .correction
                .elastic()
                .map(|e| e.report.curve.is_some());
            (found.blob.bytes().to_vec(), errors, curve)
        };
        let one = on(1);
        if method == Method::Elastic {
            assert_eq!(
                one.2,
                Some(true),
                "the model has no own-joint curve, so the test does not cover it"
            );
        }
        for threads in [2, 16] {
            assert!(on(threads) == one, "{method:?} on {threads} threads");
        }
    }
}

/// All sizes of the learning curve are fitted in parallel. They are returned in order, and each is reported once.
#[test]
fn no_learning_curve_depends_on_the_number_of_threads() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let curves = Curves::draw(6, 18, 3e-4, &mut random);
    let train = measured(&curves, 140, &mut random, anywhere);
    let tests = [TestSet {
        name: "test".to_owned(),
        samples: measured(&curves, 20, &mut random, anywhere),
    }];
    let (robot, origin) = (robot(), origin(vec![ToolName::default()]));
    let config = Config::new(Method::Poe);
    let on = |threads: usize| {
        let task = Task {
            threads,
            ..task(&robot, &train, &tests, 0, &origin)
        };
        let whole = task.run(&config, &mut || ()).unwrap();
        let mut done = 0;
        let points = curve(&task, &config, &whole.sets[0].poses, &mut || done += 1);
        assert_eq!(done, sizes(&task, &config).len());
        points
    };
    let one = on(1);
    let trained: Vec<usize> = one.iter().map(|point| point.trained_on).collect();
    assert_eq!(trained, [25, 50, 100, 140]);
    for threads in [2, 16] {
        assert_eq!(on(threads), one, "{threads} threads");
    }
}
