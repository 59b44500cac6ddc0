//! Status remarks as sets, and the texts and codes of errors.

use std::collections::BTreeSet;

use poegp_protocol::JointKind;
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::load_error::LoadError;
use poegp_runtime::model::signature::SignatureError;

#[test]
fn remarks_are_a_set() {
    let outside = Status::OUTSIDE_JOINT_RANGE;
    let both = outside.with(Status::BAD_INPUT);
    assert_eq!(both.bits(), 17);
    assert_eq!(both.with(outside), both);
    assert_eq!(Status::from_bits(17), both);
    assert!(both.contains(outside) && both.contains(Status::OK));
    assert!(!outside.contains(both));
    assert!(!both.contains(Status::NO_MODEL));
    assert!(Status::OK.is_ok() && Status::default().is_ok() && !both.is_ok());
    assert_eq!(outside.with_if(false, Status::BAD_INPUT), outside);
    assert_eq!(outside.with_if(true, Status::BAD_INPUT), both);
    assert_eq!(Status::OK.to_string(), "ok");
    assert_eq!(outside.to_string(), "outside-joint-range");
    assert_eq!(both.to_string(), "outside-joint-range+bad-input");
    assert_eq!(Status::from_bits(128).to_string(), "blending");
}

#[test]
fn errors_of_loading_say_what_is_wrong() {
    let all = [
        LoadError::Chain,
        LoadError::Frame { index: 3 },
        LoadError::Coupling,
        LoadError::JointLimits,
        LoadError::Ranges,
        LoadError::Inputs {
            found: 8,
            expected: 7,
        },
        LoadError::Kernel,
        LoadError::CorrectionLimit,
        LoadError::PartialRow { bytes: 5 },
        LoadError::InducingPointsTooLarge {
            needed: 5_000,
            capacity: 4_096,
        },
        LoadError::Row,
        LoadError::Gravity,
        LoadError::Ripple,
        LoadError::Groups,
        LoadError::Variance,
        LoadError::Curve,
    ];
    // A code on the wire never changes.
    for (code, error) in (1..).zip(all) {
        assert_eq!(error.code(), code, "{error}");
    }
    let texts: BTreeSet<String> = all.iter().map(ToString::to_string).collect();
    assert_eq!(texts.len(), all.len());
    assert!(texts.iter().all(|text| text.len() > 15), "{texts:?}");
    for number in [
        "frame 3",
        "has 8 inputs",
        "make 7",
        "5 bytes",
        "5000 numbers",
    ] {
        assert!(texts.iter().any(|text| text.contains(number)), "{number}");
    }
}

#[test]
fn a_wrong_chain_says_what_was_given() {
    let frames = [Pose::<f64>::identity(); 5];
    let wrong = Poe::new(&[JointKind::Revolute; 2], &frames).unwrap_err();
    assert_eq!(
        wrong.to_string(),
        "2 joints and 5 frames: 1 to 8 joints and one frame more are a chain"
    );
}

const WRONG_KEY: SignatureError = SignatureError::WrongKey {
    id: [10, 255, 0, 1, 2, 3, 4, 5],
};

#[test]
fn errors_of_signatures_say_what_is_wrong() {
    assert_eq!(
        WRONG_KEY.to_string(),
        "the blob is signed by another key, 0aff000102030405"
    );
    let all = [
        SignatureError::Malformed,
        SignatureError::Unsigned,
        WRONG_KEY,
        SignatureError::Invalid,
    ];
    assert_eq!(all.map(|error| error.code()), [1, 2, 3, 4]);
    let texts: BTreeSet<String> = all.iter().map(ToString::to_string).collect();
    assert_eq!(texts.len(), all.len());
    assert!(texts.iter().all(|text| text.len() > 15), "{texts:?}");
}
