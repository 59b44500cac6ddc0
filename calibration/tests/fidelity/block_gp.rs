//! The joint-space processes solved together with the frames: weights, deflections and poses against numpy, and the
//! gradient of the marginal likelihood against finite differences.

use nalgebra::Vector3;
use poegp_calibration::identification::base_tools::fit_base_and_tools;
use poegp_calibration::identification::parametric::state::{
    Layout, Linearised, ParametricModel, PriorGroup,
};
use poegp_calibration::learning::elastic::hyperparameters::{COMMON, DEFLECTION_UNIT, HyperLayout};
use poegp_calibration::learning::elastic::inputs::Inputs;
use poegp_calibration::learning::elastic::likelihood::MarginalLikelihood;
use poegp_calibration::measurement::noise::{InstrumentNoise, NoiseScales};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Base, BaseSample, Sample, in_base_frame};
use poegp_calibration::numeric::lbfgs::Objective;
use poegp_calibration::numeric::matrix::Mat;
use poegp_protocol::JointKind;
use poegp_runtime::gp::joint_kernel::similarity;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use serde_json::Value;

use crate::json::{largest_difference, list, numbers, parse, pose_rows};
use crate::say;
use crate::sets::{arm, simulated};

const BLOCK_GP: &str = include_str!("../../../tests/data/vectors/block_gp.json");
const JOINTS: usize = 6;

fn pose(matrix: &Value) -> Pose<f64> {
    Pose::from_rows(&pose_rows(matrix))
}

fn poses(matrices: &Value) -> Vec<Pose<f64>> {
    list(matrices).iter().map(pose).collect()
}

fn chain(frames: &Value) -> Poe<f64> {
    Poe::new(&[JointKind::Revolute; JOINTS], &poses(frames)).unwrap()
}

fn samples(file: &Value, joints: &str, payloads: &str, measured: &str) -> Vec<BaseSample> {
    let rows = list(&file[joints]).iter().map(numbers);
    let measured = poses(&file[measured]);
    rows.zip(numbers(&file[payloads]))
        .zip(measured)
        .map(|((joints, payload), measured)| Sample {
            payload_kg: Some(payload),
            ..Sample::new(joints.clone(), joints, Observation::Pose(measured), Base)
        })
        .collect()
}

/// Returns a model with frames alone: no gravity terms, no ripple.
fn frames_only(chain: &Poe<f64>, payload: bool, gravity: bool) -> ParametricModel {
    let layout = Layout {
        joints: JOINTS,
        tools: 1,
        gravity,
        payload,
        ripple: Vec::new(),
    };
    let tool = chain.frames()[JOINTS];
    let down = Vector3::new(0.0, 0.0, -9.81);
    ParametricModel::new(chain, vec![tool], None, layout, down)
}

/// Returns the hyperparameters of the vector file in our order; our payloads are in kg, the file's in units of m0.
fn hyperparameters(file: &Value, layout: HyperLayout) -> Vec<f64> {
    let theta = numbers(&file["theta_log"]);
    let at = |name: &str| -> Vec<usize> {
        let found = numbers(&file["layout"][name]);
        found.iter().map(|i| *i as usize).collect()
    };
    let (w0, a0, wm, a1) = (at("w0"), at("a0"), at("wm"), at("a1"));
    let unit = 2.0 * libm::log(file["m0"].as_f64().unwrap());
    let mut out = vec![0.0; layout.len()];
    let noise = file["layout"]["n"].as_u64().unwrap() as usize;
    (out[0], out[1]) = (theta[noise], theta[noise]);
    for c in 0..JOINTS {
        for d in 0..JOINTS {
            out[layout.scale(c, d)] = theta[w0[JOINTS * c + d]];
        }
        out[layout.scale(c, JOINTS)] = theta[wm[c]] - unit;
        out[layout.amplitude(c, 0)] = theta[a0[c]];
        out[layout.amplitude(c, 1)] = theta[a1[c]] - unit;
    }
    out
}

/// Returns the largest difference as a share of the largest expected number.
fn share(ours: &[f64], theirs: &[f64]) -> f64 {
    let largest = theirs.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    largest_difference(ours, theirs) / largest
}

/// Returns the largest distance between origins in metres, and largest angle in radians.
fn apart(ours: &[Pose<f64>], theirs: &[Pose<f64>]) -> (f64, f64) {
    let pairs = ours.iter().zip(theirs);
    pairs.fold((0.0, 0.0), |(distance, angle): (f64, f64), (a, b)| {
        (
            distance.max((a.translation - b.translation).norm()),
            angle.max((a.inverse() * *b).log().angular.norm()),
        )
    })
}

/// Returns the likelihood with processes of all joints and no own-joint curve.
fn likelihood<'a>(
    linear: &'a Linearised,
    groups: &'a [PriorGroup],
    (inputs, similarities): (&'a Inputs, &'a [Mat<f64>]),
    layout: HyperLayout,
) -> MarginalLikelihood<'a> {
    MarginalLikelihood {
        linear,
        groups,
        inputs,
        similarities,
        waves: &[],
        layout,
        processes: true,
        threads: 2,
    }
}

#[test]
fn weights_deflections_and_poses_are_numpys() {
    let file = parse(BLOCK_GP);
    let mut state = frames_only(&chain(&file["P_start"]), false, false);
    let train = samples(&file, "q", "m", "T_meas");
    let test = samples(&file, "q_test", "m_test", "T_test");
    let layout = HyperLayout {
        joints: JOINTS,
        payload: true,
        curve: false,
    };
    let h = hyperparameters(&file, layout);
    let scales = NoiseScales::uniform(file["sp"].as_f64().unwrap(), file["sr"].as_f64().unwrap());
    let inputs = Inputs::new(&state, &train);
    let similarities = inputs.similarities();
    // In the reference all frames have the prior that the arm's frames have here.
    let groups = vec![PriorGroup::Frames; state.deviation.len()];
    assert_eq!(
        PriorGroup::Frames.prior_sd(),
        file["prior_sd_param"].as_f64().unwrap()
    );
    // Two solutions: the second is linearised at the frames of the first, with its prior around them as well. The fit keeps
    // the prior where it was, but the reference did not, so the test resets the deviation.
    let mut solve = || {
        state.deviation.fill(0.0);
        let linear = state.linearise(&train, scales);
        let evidence = likelihood(&linear, &groups, (&inputs, &similarities), layout);
        let solved = evidence.solve(&h).unwrap();
        state.update(&solved.parameters);
        solved
    };
    solve();
    let solved = solve();

    // The reference's weights are per 1e-4 rad.
    let at = |k: usize| (0..JOINTS).map(move |c| (k, c));
    let weights: Vec<f64> = (0..train.len())
        .flat_map(at)
        .map(|(k, c)| DEFLECTION_UNIT * solved.weights[(k, c)])
        .collect();
    let weights = share(&weights, &numbers(&file["weights"]));

    let kernels = layout.kernels(&h);
    let asked = Inputs::new(&state, &test);
    let calibrated = state.chain(0);
    let (mut deflections, mut predicted) = (Vec::new(), Vec::new());
    for (i, sample) in test.iter().enumerate() {
        let mut joints = sample.joints.clone();
        for (c, kernel) in kernels.iter().enumerate() {
            let value: f64 = (0..train.len())
                .map(|k| {
                    let s: Vec<f64> = (0..JOINTS)
                        .map(|d| {
                            let (a, b) = (&asked.features[i][d], &inputs.features[k][d]);
                            similarity(JointKind::Revolute, a, b)
                        })
                        .collect();
                    let factor = kernel.payload_factor(asked.payloads[i], inputs.payloads[k]);
                    factor * kernel.joint_factor(&s) * solved.weights[(k, c)]
                })
                .sum();
            deflections.push(value / DEFLECTION_UNIT);
            joints[c] += value;
        }
        predicted.push(calibrated.forward(&joints));
    }
    let deflections = share(&deflections, &numbers(&file["dq_test_1e_4"]));
    let (distance, angle) = apart(&predicted, &poses(&file["T_test"]));
    let (frame_distance, frame_angle) = apart(calibrated.frames(), &poses(&file["P_end"]));
    say(format_args!(
        "block GP against numpy: weights {weights:.1e} and deflections {deflections:.1e} of the largest, poses \
         {distance:.1e} m {angle:.1e} rad, frames {frame_distance:.1e} m {frame_angle:.1e} rad"
    ));
    assert!(weights <= 1e-9 && deflections <= 1e-9);
    assert!(distance <= 1e-12 && angle <= 1e-12);
    assert!(frame_distance <= 1e-12 && frame_angle <= 1e-12);
}

/// Returns poses of the simulated arm in its base frame, with or without their payloads.
fn in_base(count: usize, payload: bool) -> (Poe<f64>, Vec<BaseSample>) {
    let (robot, nominal) = arm();
    let mut samples = simulated(&robot, "train");
    samples.truncate(count);
    if !payload {
        samples.iter_mut().for_each(|s| s.payload_kg = None);
    }
    let found = fit_base_and_tools(&nominal, &samples);
    let mut frames = nominal.frames().to_vec();
    frames[JOINTS] = frames[JOINTS] * found.flange_from_targets[0];
    let chain = Poe::new(nominal.kinds(), &frames).unwrap();
    (chain, in_base_frame(&samples, &found.instrument_from_base))
}

#[test]
fn the_gradient_is_that_of_differences() {
    for (payload, uneven) in [(false, false), (true, false), (true, true)] {
        let mut scales = NoiseScales::uniform(2e-4, 3e-4);
        let (chain, mut samples) = in_base(20, payload);
        if uneven {
            for (k, sample) in samples.iter_mut().enumerate() {
                sample.declared_noise.position = Some(1e-4 * (1 + k % 3) as f64);
                sample.declared_noise.orientation = Some(2e-4 * (1 + k % 2) as f64);
            }
            scales.quietest = InstrumentNoise::min_over(&samples);
        }
        let state = frames_only(&chain, payload, true);
        let linear = state.linearise(&samples, scales);
        let groups = state.layout.groups();
        let inputs = Inputs::new(&state, &samples);
        let similarities: Vec<Mat<f64>> = inputs.similarities();
        let layout = HyperLayout {
            joints: JOINTS,
            payload,
            curve: false,
        };
        let evidence = likelihood(&linear, &groups, (&inputs, &similarities), layout);
        // Not at the start, where all outputs are alike; priors stay large enough to matter.
        let mut h = layout.start_and_bounds(4.0).0;
        for (i, value) in h.iter_mut().enumerate() {
            *value += 0.4 * libm::sin(1.7 * i as f64);
        }
        let (_, gradient) = evidence.value_and_gradient(&h);
        let largest = gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        let mut worst = 0.0_f64;
        for i in 0..h.len() {
            let at = |step: f64| {
                let mut moved = h.clone();
                moved[i] += step;
                evidence.value_and_gradient(&moved).0
            };
            // Fourth order with a large step, because a value has seven digits less than f64 has: S is that ill-conditioned
            // (the tool's prior against the noise).
            let step = 3e-2;
            let central =
                (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step))) / (12.0 * step);
            worst = worst.max((gradient[i] - central).abs() / largest);
            // Without payloads nothing depends on the prior of the payload terms.
            assert!(gradient[i] != 0.0 || (!payload && i == COMMON - 1), "{i}");
        }
        let of = |yes: bool, name: &str| if yes { name.to_owned() } else { String::new() };
        say(format_args!(
            "marginal likelihood of the elastic model{}{}: gradient of {} hyperparameters {worst:.1e} of its largest \
             component against differences",
            of(payload, ", with payload"),
            of(uneven, ", with rows of their own noise"),
            h.len()
        ));
        assert!(worst <= 1e-7, "{worst}");
    }
}
