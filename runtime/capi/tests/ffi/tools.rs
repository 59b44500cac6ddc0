//! Pose, Jacobian and inverse of a tool, and everything in double precision: the answers are the runtime's, and an error
//! comes with a safe answer.

use std::mem::offset_of;

use super::*;

/// A tool 0.2 m off the target, turned by 90 degrees about z.
const TOOL: [f64; 12] = [
    0.0, -1.0, 0.0, 0.05, //
    1.0, 0.0, 0.0, -0.1, //
    0.0, 0.0, 1.0, 0.2,
];
const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// The laws for one precision.
macro_rules! laws {
    ($precision:ident, $number:ty, $bytes:expr, $filter_bytes:expr,
     $init:ident $load:ident $load_signed:ident $identify:ident $size:ident
     $evaluate:ident $correct:ident $forward:ident $inverse:ident $jacobian:ident
     $defaults:ident $filter_init:ident $filter_size:ident $command:ident $disengaged:ident $counts:ident $reset:ident) => {
        mod $precision {
            use poegp_runtime::filter::{CommandFilter, FilterSettings as Settings};
            use poegp_runtime::math::se3::Pose;

            use super::*;

            type N = $number;
            type OurModel = poegp_capi::types::Model<N>;

            #[repr(C, align(8))]
            struct Room<const BYTES: usize>([u8; BYTES]);

            fn made(memory: &mut Room<{ $bytes }>) -> *mut OurModel {
                let mut model = null_mut();
                // SAFETY: the memory is exclusively borrowed and as large as is said.
                let code = unsafe { $init((&raw mut *memory).cast(), $bytes, &raw mut model) };
                assert_eq!(code, POEGP_OK);
                model
            }

            fn loaded(memory: &mut Room<{ $bytes }>) -> *mut OurModel {
                let model = made(memory);
                // SAFETY: a slice is as long as it says.
                let code = unsafe { $load(model, BLOB.as_ptr(), BLOB.len()) };
                assert_eq!(code, POEGP_OK);
                model
            }

            fn room() -> Box<Room<{ $bytes }>> {
                Box::new(Room([0; $bytes]))
            }

            fn arm() -> Box<Arm<N, { words_for(64) }>> {
                let mut arm = Box::new(Arm::new());
                arm.load_decoded(&blob::decode(BLOB).unwrap()).unwrap();
                arm
            }

            fn numbers<const COUNT: usize>(values: [f64; COUNT]) -> [N; COUNT] {
                values.map(|value| value as N)
            }

            fn command() -> [N; 6] {
                COMMAND.map(|joint| N::from(joint))
            }

            fn forward(
                model: *const OurModel,
                tool: *const N,
                joints: &[N],
                kg: N,
            ) -> (i32, Forward<N>) {
                // SAFETY: a slice is as long as it says, and tools have twelve numbers or are refused.
                answered(|out| unsafe {
                    $forward(model, tool, joints.as_ptr(), joints.len(), kg, out)
                })
            }

            fn jacobian(
                model: *const OurModel,
                tool: *const N,
                joints: &[N],
                kg: N,
            ) -> (i32, Jacobian<N>) {
                // SAFETY: the same.
                answered(|out| unsafe {
                    $jacobian(model, tool, joints.as_ptr(), joints.len(), kg, out)
                })
            }

            fn inverse(
                model: *const OurModel,
                tool: *const N,
                wanted: *const N,
                seed: &[N],
                kg: N,
            ) -> (i32, Inverse<N>) {
                answered(|out| {
                    let (start, count) = (seed.as_ptr(), seed.len());
                    // SAFETY: the same.
                    unsafe { $inverse(model, tool, wanted, start, count, kg, out) }
                })
            }

            #[test]
            fn answers_are_those_of_the_runtime() {
                assert!($size() <= $bytes && $filter_size() <= $filter_bytes);
                let mut memory = room();
                let model = loaded(&mut memory);
                let arm = arm();
                let tool = numbers(TOOL);
                let pose = Pose::from_rows(&tool);
                let q = command();
                for kg in [0.0, 1.5, 5.0, 90.0, N::NAN] {
                    // SAFETY: arrays are as long as is said.
                    let (code, found) =
                        answered(|out| unsafe { $evaluate(model, q.as_ptr(), 6, kg, out) });
                    let expected = arm.evaluate(&q, kg);
                    assert_eq!(
                        (code, found.status),
                        (POEGP_OK, u32::from(expected.status.bits()))
                    );
                    assert_eq!(found.base_from_target, expected.pose.to_rows());
                    assert_eq!(found.correction, expected.correction.to_array());
                    // SAFETY: the same.
                    let (code, found) =
                        answered(|out| unsafe { $correct(model, q.as_ptr(), 6, kg, out) });
                    let expected = arm.correct(&q, kg);
                    assert_eq!(
                        (code, found.status),
                        (POEGP_OK, u32::from(expected.status.bits()))
                    );
                    assert_eq!(
                        (found.joints, found.applied),
                        (expected.joints, expected.applied)
                    );
                    assert_eq!(found.position_error, expected.position_error);
                    assert_eq!(found.rotation_error, expected.rotation_error);

                    let (code, found) = forward(model, tool.as_ptr(), &q, kg);
                    let expected = arm.tool_pose(&pose, &q, kg);
                    assert_eq!(
                        (code, found.status),
                        (POEGP_OK, u32::from(expected.status.bits()))
                    );
                    assert_eq!(
                        (found.base_from_tool, found.trust),
                        (expected.pose.to_rows(), expected.trust)
                    );
                    // Without a tool the pose is that of the target.
                    let bare = forward(model, null(), &q, kg).1.base_from_tool;
                    assert_eq!(bare, arm.evaluate(&q, kg).pose.to_rows());

                    let (code, found) = jacobian(model, tool.as_ptr(), &q, kg);
                    let expected = arm.tool_jacobian(&pose, &q, kg);
                    assert_eq!(
                        (code, found.status),
                        (POEGP_OK, u32::from(expected.status.bits()))
                    );
                    for (r, row) in found.rows.iter().enumerate() {
                        for (value, column) in row.iter().zip(&expected.columns) {
                            assert_eq!(*value, column[r]);
                        }
                    }

                    let wanted = arm.tool_pose(&pose, &q, 2.0).pose;
                    let rows = wanted.to_rows();
                    let seed = q.map(|joint| joint + 0.01);
                    let (code, found) = inverse(model, tool.as_ptr(), rows.as_ptr(), &seed, kg);
                    let expected = arm.tool_inverse(&wanted, &pose, &seed, kg);
                    assert_eq!(
                        (code, found.status),
                        (POEGP_OK, u32::from(expected.status.bits()))
                    );
                    assert_eq!(found.joints, expected.joints);
                    assert_eq!(found.position_error, expected.position_error);
                    assert_eq!(found.rotation_error, expected.rotation_error);
                }
                // SAFETY: the pointer to the answer is good.
                let (code, identity) = answered(|out| unsafe { $identify(model, out) });
                assert_eq!((code, identity.joints), (POEGP_OK, 6));
            }

            /// For any tool, and with the joints of an earlier cycle as seed.
            #[test]
            fn the_inverse_undoes_forward() {
                let mut memory = room();
                let model = loaded(&mut memory);
                let tool = numbers(TOOL);
                let q = command();
                let near = N::EPSILON * 64.0;
                for tool in [tool.as_ptr(), null()] {
                    let pose = forward(model, tool, &q, 2.0).1.base_from_tool;
                    let seed = q.map(|joint| joint - 0.002);
                    let (code, found) = inverse(model, tool, pose.as_ptr(), &seed, 2.0);
                    assert_eq!((code, found.status), (POEGP_OK, 0));
                    assert!(
                        found.position_error <= near && found.rotation_error <= near,
                        "{found:?}"
                    );
                    let there = forward(model, tool, &found.joints[..6], 2.0)
                        .1
                        .base_from_tool;
                    for (a, b) in there.iter().zip(&pose) {
                        assert!((a - b).abs() <= near, "{a} {b}");
                    }
                }
            }

            #[test]
            fn bad_handles_are_refused_and_the_answer_is_safe() {
                let mut memory = room();
                let raw = (&raw mut *memory).cast::<OurModel>();
                let tool = numbers(TOOL);
                let mut seed = command();
                seed[2] = N::NEG_INFINITY;
                let kept = [seed[0], seed[1], 0.0, seed[3], seed[4], seed[5], 0.0, 0.0];
                for (model, expected) in [
                    (null_mut(), POEGP_ERROR_NULL),
                    (raw.wrapping_byte_add(2), POEGP_ERROR_MISALIGNED),
                    (raw, POEGP_ERROR_NOT_INITIALISED),
                ] {
                    // SAFETY: refused.
                    let code = unsafe { $load(model, BLOB.as_ptr(), BLOB.len()) };
                    assert_eq!(code, expected);
                    let (code, found) = forward(model, tool.as_ptr(), &command(), 1.0);
                    assert_eq!((code, found.status), (expected, POEGP_STATUS_NO_MODEL));
                    assert_eq!(
                        (found.base_from_tool, found.trust),
                        (numbers(IDENTITY), 0.0)
                    );
                    let (code, found) = jacobian(model, tool.as_ptr(), &command(), 1.0);
                    assert_eq!((code, found.status), (expected, POEGP_STATUS_NO_MODEL));
                    assert_eq!(found.rows, [[0.0; 8]; 6]);
                    let (code, found) = inverse(model, null(), tool.as_ptr(), &seed, 1.0);
                    assert_eq!((code, found.status), (expected, POEGP_STATUS_NO_MODEL));
                    assert_eq!(found.joints, kept);
                }
                // A model without a blob is no error, but has no answer.
                let model = made(&mut memory);
                let (code, found) = inverse(model, null(), tool.as_ptr(), &seed, 1.0);
                assert_eq!((code, found.status), (POEGP_OK, POEGP_STATUS_NO_MODEL));
                assert_eq!(found.joints, kept);
                let (code, found) = forward(model, tool.as_ptr(), &command(), 1.0);
                assert_eq!((code, found.status), (POEGP_OK, POEGP_STATUS_NO_MODEL));
                assert_eq!(found.base_from_tool, numbers(IDENTITY));
            }

            #[test]
            fn bad_arguments_are_refused_and_the_answer_is_safe() {
                let mut memory = room();
                let model = loaded(&mut memory);
                let tool = numbers(TOOL);
                let q = command();
                let mut kept = [0.0; 8];
                kept[..6].copy_from_slice(&q);
                let odd = tool.as_ptr().wrapping_byte_add(1);
                // Pointers that cannot be used.
                let (code, found) = inverse(model, null(), null(), &q, 1.0);
                assert_eq!(
                    (code, found.status),
                    (POEGP_ERROR_NULL, POEGP_STATUS_BAD_INPUT)
                );
                assert_eq!(found.joints, kept);
                for (tool, wanted) in [(odd, tool.as_ptr()), (tool.as_ptr(), odd)] {
                    let (code, found) = inverse(model, tool, wanted, &q, 1.0);
                    assert_eq!(
                        (code, found.status),
                        (POEGP_ERROR_MISALIGNED, POEGP_STATUS_BAD_INPUT)
                    );
                    assert_eq!(found.joints, kept);
                }
                let (code, found) = forward(model, odd, &q, 1.0);
                assert_eq!(
                    (code, found.status),
                    (POEGP_ERROR_MISALIGNED, POEGP_STATUS_BAD_INPUT)
                );
                assert_eq!(found.base_from_tool, numbers(IDENTITY));
                // SAFETY: refused before it is read.
                let (code, found) =
                    answered(|out| unsafe { $jacobian(model, null(), null(), 6, 1.0, out) });
                assert_eq!((code, found.rows), (POEGP_ERROR_NULL, [[0.0; 8]; 6]));
                // SAFETY: the same.
                let (code, found) = answered(|out| unsafe {
                    $inverse(model, null(), tool.as_ptr(), null(), 6, 1.0, out)
                });
                assert_eq!((code, found.joints), (POEGP_ERROR_NULL, [0.0; 8]));
                // Answers that cannot be written.
                for (out, expected) in [
                    (null_mut(), POEGP_ERROR_NULL),
                    (model.cast::<Inverse<N>>(), POEGP_ERROR_OVERLAP),
                    (
                        model.cast::<Inverse<N>>().wrapping_byte_add(1),
                        POEGP_ERROR_MISALIGNED,
                    ),
                ] {
                    // SAFETY: refused before it is written.
                    let code =
                        unsafe { $inverse(model, null(), tool.as_ptr(), q.as_ptr(), 6, 1.0, out) };
                    assert_eq!(code, expected);
                    // SAFETY: the same.
                    let code = unsafe { $forward(model, null(), q.as_ptr(), 6, 1.0, out.cast()) };
                    assert_eq!(code, expected);
                    // SAFETY: the same.
                    let code = unsafe { $jacobian(model, null(), q.as_ptr(), 6, 1.0, out.cast()) };
                    assert_eq!(code, expected);
                }
                // Invalid numbers: transposed or long axes, too many joints.
                let mut long = tool;
                long[1] = -1.01;
                let mut not_a_number = tool;
                not_a_number[3] = N::NAN;
                for bad in [long, not_a_number, [0.0; 12]] {
                    for (tool, wanted) in [(bad, tool), (tool, bad)] {
                        let (code, found) = inverse(model, tool.as_ptr(), wanted.as_ptr(), &q, 1.0);
                        assert_eq!((code, found.status), (POEGP_OK, POEGP_STATUS_BAD_INPUT));
                        assert_eq!(found.joints, kept);
                    }
                    let (code, found) = forward(model, bad.as_ptr(), &q, 1.0);
                    assert_eq!((code, found.status), (POEGP_OK, POEGP_STATUS_BAD_INPUT));
                    assert_eq!(found.base_from_tool, numbers(IDENTITY));
                    let (code, found) = jacobian(model, bad.as_ptr(), &q, 1.0);
                    assert_eq!((code, found.status), (POEGP_OK, POEGP_STATUS_BAD_INPUT));
                    assert_eq!(found.rows, [[0.0; 8]; 6]);
                }
                let (code, found) = inverse(model, null(), tool.as_ptr(), &[0.25; 40], 1.0);
                let expected = (POEGP_ERROR_JOINTS, POEGP_STATUS_BAD_INPUT);
                assert_eq!((code, found.status), expected);
                assert_eq!(found.joints, [0.25; 8]);
                let (code, found) = forward(model, null(), &q[..5], 1.0);
                assert_eq!((code, found.status), expected);
                let (code, found) = jacobian(model, null(), &q[..5], 1.0);
                assert_eq!((code, found.status), expected);
            }

            #[test]
            fn arguments_may_lie_in_the_answer() {
                let mut memory = room();
                let model = loaded(&mut memory);
                let q = command();
                let pose = forward(model, null(), &q, 2.0).1.base_from_tool;
                let seed = q.map(|joint| joint + 0.01);
                let expected = inverse(model, null(), pose.as_ptr(), &seed, 2.0).1;
                let mut answer = expected;
                answer.joints[..6].copy_from_slice(&seed);
                let place = &raw mut answer;
                let joints = place
                    .cast::<N>()
                    .wrapping_byte_add(offset_of!(Inverse<N>, joints));
                // SAFETY: six joints lie in the answer.
                let code = unsafe { $inverse(model, null(), pose.as_ptr(), joints, 6, 2.0, place) };
                assert_eq!((code, answer), (POEGP_OK, expected));

                let tool = numbers(TOOL);
                let expected = forward(model, tool.as_ptr(), &q, 2.0).1;
                let mut answer = expected;
                answer.base_from_tool = tool;
                let place = &raw mut answer;
                let rows = place
                    .cast::<N>()
                    .wrapping_byte_add(offset_of!(Forward<N>, base_from_tool));
                // SAFETY: twelve numbers lie in the answer.
                let code = unsafe { $forward(model, rows, q.as_ptr(), 6, 2.0, place) };
                assert_eq!((code, answer), (POEGP_OK, expected));
            }

            #[test]
            fn commands_are_those_of_the_runtime() {
                let mut memory = room();
                let model = loaded(&mut memory);
                let arm = arm();
                let mut filter_memory = Box::new(Room([0; $filter_bytes]));
                // SAFETY: the pointer to the answer is good.
                let (code, settings) = answered(|out| unsafe { $defaults(0.01, out) });
                assert_eq!(code, POEGP_OK);
                let mut filter = null_mut();
                let start = (&raw mut *filter_memory).cast();
                // SAFETY: the memory is as large as is said.
                let code = unsafe {
                    $filter_init(start, $filter_bytes, &raw const settings, &raw mut filter)
                };
                assert_eq!(code, POEGP_OK);
                let mut ours = CommandFilter::<N>::new();
                ours.configure(&Settings::with_period(0.01)).unwrap();
                for cycle in 0..200_u16 {
                    let q = command().map(|joint| joint + N::from(cycle) * 1e-3);
                    let engage = cycle < 120;
                    let (code, found) = answered(|out| {
                        let joints = q.as_ptr();
                        // SAFETY: arrays are as long as is said.
                        unsafe {
                            $command(model, filter, joints, 6, 2.0, i32::from(engage), 1, out)
                        }
                    });
                    let kg = ours.payload(2.0, 1);
                    let corrected = arm.correct(&q, kg);
                    let expected = ours.step(&q, &corrected.joints, corrected.status, engage, 1);
                    assert_eq!((code, found.joints), (POEGP_OK, expected.joints), "{cycle}");
                    assert_eq!(
                        (found.weight, found.applied),
                        (expected.weight, corrected.applied)
                    );
                    // SAFETY: a filter.
                    let rests = unsafe { $disengaged(filter) };
                    assert_eq!(rests != 0, ours.disengaged());
                }
                // SAFETY: the pointer to the answer is good.
                let (code, counts) = answered(|out| unsafe { $counts(filter, out) });
                assert_eq!((code, counts.lost), (POEGP_OK, ours.counts().lost));
                // SAFETY: a filter.
                assert_eq!(unsafe { $reset(filter) }, POEGP_OK);
                // A model is not a filter.
                // SAFETY: refused.
                assert_eq!(unsafe { $reset(model.cast()) }, POEGP_ERROR_NOT_INITIALISED);
            }

            #[test]
            fn a_signature_is_asked_for() {
                let keys = KeyPair::from_seed(Seed::new([7; 32]));
                let mut memory = room();
                let model = made(&mut memory);
                let load = |bytes: &[u8]| {
                    // SAFETY: lengths are those of the slices.
                    unsafe { $load_signed(model, bytes.as_ptr(), bytes.len(), keys.pk.as_ptr()) }
                };
                assert_eq!(load(BLOB), POEGP_SIGNATURE_UNSIGNED);
                assert_eq!(load(&signed(&keys)), POEGP_OK);
            }
        }
    };
}

laws!(single, f32, POEGP_MODEL_BYTES, POEGP_FILTER_BYTES,
    poegp_init poegp_load poegp_load_signed poegp_identify poegp_model_size
    poegp_evaluate poegp_correct poegp_forward poegp_inverse poegp_jacobian
    poegp_filter_defaults poegp_filter_init poegp_filter_size poegp_command poegp_filter_disengaged poegp_filter_counts poegp_filter_reset);
laws!(double, f64, POEGP_MODEL_F64_BYTES, POEGP_FILTER_F64_BYTES,
    poegp_init_f64 poegp_load_f64 poegp_load_signed_f64 poegp_identify_f64 poegp_model_size_f64
    poegp_evaluate_f64 poegp_correct_f64 poegp_forward_f64 poegp_inverse_f64 poegp_jacobian_f64
    poegp_filter_defaults_f64 poegp_filter_init_f64 poegp_filter_size_f64 poegp_command_f64 poegp_filter_disengaged_f64 poegp_filter_counts_f64 poegp_filter_reset_f64);

/// Both precisions have the same arm, and double precision does not compute in single precision.
#[test]
fn double_precision_is_double() {
    let arm = arm();
    let mut wide = Box::new(Arm::<f64, { words_for(64) }>::new());
    wide.load_decoded(&blob::decode(BLOB).unwrap()).unwrap();
    let q = COMMAND.map(f64::from);
    let single = arm.evaluate(&COMMAND, 2.0).pose.to_rows();
    let mut memory = Box::new(DoubleMemory([0; POEGP_MODEL_F64_BYTES]));
    let mut model = null_mut();
    let start = (&raw mut *memory).cast();
    // SAFETY: the memory is as large as is said.
    let code = unsafe { poegp_init_f64(start, POEGP_MODEL_F64_BYTES, &raw mut model) };
    assert_eq!(code, POEGP_OK);
    // SAFETY: a slice is as long as it says.
    assert_eq!(
        unsafe { poegp_load_f64(model, BLOB.as_ptr(), BLOB.len()) },
        POEGP_OK
    );
    let at = |q: &[f64; 6]| {
        // SAFETY: arrays are as long as is said.
        answered(|out| unsafe { poegp_forward_f64(model, null(), q.as_ptr(), 6, 2.0, out) }).1
    };
    let found = at(&q).base_from_tool;
    let mut rounded = 0;
    for (a, b) in found.iter().zip(&single) {
        assert!((a - f64::from(*b)).abs() < 2e-6, "{a} {b}");
        rounded += usize::from(*a as f32 as f64 == *a && a.abs() > 1e-3);
    }
    assert_eq!(rounded, 0, "{found:?}");
    // A step of 1e-12 rad changes the pose, by as much as the Jacobian says.
    // SAFETY: arrays are as long as is said.
    let jacobian =
        answered(|out| unsafe { poegp_jacobian_f64(model, null(), q.as_ptr(), 6, 2.0, out) }).1;
    let mut near = q;
    near[0] += 1e-10;
    let moved = at(&near).base_from_tool;
    for (r, row) in [(0, 3), (1, 7), (2, 11)] {
        let slope = (moved[row] - found[row]) / (near[0] - q[0]);
        let expected = jacobian.rows[r][0];
        assert!((slope - expected).abs() < 0.01, "{slope} {expected}");
    }
}

#[repr(C, align(8))]
struct DoubleMemory([u8; POEGP_MODEL_F64_BYTES]);
