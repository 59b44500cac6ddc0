/* Calibrated robot arms for programs in C. README.md in the parent folder explains how to link and use the library.

   Generated from the Rust sources; do not edit (see tests/header.rs). Units are radians, metres and kilograms. The
   library checks every pointer as far as it can and refuses those that are null, misaligned or overlapping. It
   cannot check that a pointer leads to as much memory as stated: the caller must guarantee this (# Safety). */

#ifndef POEGP_H
#define POEGP_H

#include <stddef.h>
#include <stdint.h>

/*
 Version of this interface. It changes when a function, a structure or the meaning of a code changes; see
 `poegp_api_version`.
 */
#define POEGP_API_VERSION 4

/*
 Largest number of joints of an arm.
 */
#define POEGP_MAX_JOINTS 8

/*
 Size in bytes of a name in `poegp_identity_t`, including the terminating zero.
 */
#define POEGP_NAME_BYTES 36

/*
 Size in bytes of the memory for one model in single precision, enough on 32-bit and 64-bit machines.
 */
#define POEGP_MODEL_BYTES 27648

/*
 Alignment in bytes of the memory for a model of either precision.
 */
#define POEGP_MODEL_ALIGN 8

/*
 Size in bytes of the memory for one filter in single precision, enough on 32-bit and 64-bit machines.
 */
#define POEGP_FILTER_BYTES 320

/*
 Alignment in bytes of the memory for a filter of either precision.
 */
#define POEGP_FILTER_ALIGN 8

/*
 Size in bytes of the memory for one model in double precision.
 */
#define POEGP_MODEL_F64_BYTES 55296

/*
 Size in bytes of the memory for one filter in double precision.
 */
#define POEGP_FILTER_F64_BYTES 640

/*
 Largest size of a cyclic frame, in bytes.
 */
#define POEGP_CYCLIC_BYTES 54

/*
 Status bit: at least one joint is outside its trained range, so the correction is an extrapolation.
 */
#define POEGP_STATUS_OUTSIDE_JOINT_RANGE 1

/*
 Status bit: the payload is outside the trained range.
 */
#define POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE 2

/*
 Status bit: the correction exceeded the limit in the blob and was scaled back to it.
 */
#define POEGP_STATUS_CORRECTION_LIMITED 4

/*
 Status bit: there is no model. The pose is the identity and the joints are those of the command.
 */
#define POEGP_STATUS_NO_MODEL 8

/*
 Status bit: the number of joints is wrong, a number is not finite, a joint is beyond 4096 rad or m, the payload is
 below 0 or above 100 000 kg, or a transform is not rigid. Nothing was corrected. Switched off or without a model,
 `poegp_command` takes any finite joints, and this bit means one that is not.
 */
#define POEGP_STATUS_BAD_INPUT 16

/*
 Status bit: by an estimate from the model, more than 5 um or 5 urad of the arm's error remain, because the arm is
 near a singularity or a bound acts.
 */
#define POEGP_STATUS_PARTLY_CORRECTED 32

/*
 Status bit of `poegp_command`: the correction is switched off. The joints to send are those of the command, or
 soon will be.
 */
#define POEGP_STATUS_BYPASSED 64

/*
 Status bit of `poegp_command`: the joints to send are still in transition to the requested ones.
 */
#define POEGP_STATUS_BLENDING 128

/*
 Success.
 */
#define POEGP_OK 0

/*
 A pointer is null.
 */
#define POEGP_ERROR_NULL 1

/*
 A pointer is not aligned for what it points to.
 */
#define POEGP_ERROR_MISALIGNED 2

/*
 The memory is too small for a model or a filter.
 */
#define POEGP_ERROR_TOO_SMALL 3

/*
 The memory was not initialised by `poegp_init` or `poegp_filter_init`.
 */
#define POEGP_ERROR_NOT_INITIALISED 4

/*
 Two arguments share memory although they must not.
 */
#define POEGP_ERROR_OVERLAP 5

/*
 A length exceeds the address space of the machine.
 */
#define POEGP_ERROR_LENGTH 6

/*
 The bytes are not an answer in a cyclic frame: they are damaged or another message, or a number is not finite.
 */
#define POEGP_ERROR_FRAME 7

/*
 The number of joints is not that of the model; or it is zero, or larger than POEGP_MAX_JOINTS.
 */
#define POEGP_ERROR_JOINTS 8

/*
 Another reason. A later version of the runtime may refuse for reasons that have no code in this version.
 */
#define POEGP_ERROR_OTHER 99

/*
 The blob has fewer bytes than it announces.
 */
#define POEGP_BLOB_TRUNCATED 101

/*
 The bytes are not a model blob: they do not begin with POEGPARM.
 */
#define POEGP_BLOB_WRONG_MAGIC 102

/*
 The blob is in a format that this version does not know.
 */
#define POEGP_BLOB_UNKNOWN_VERSION 103

/*
 The header of the blob is damaged.
 */
#define POEGP_BLOB_RESERVED_BITS 104

/*
 The blob has more bytes than it announces.
 */
#define POEGP_BLOB_TRAILING_BYTES 105

/*
 The checksum is wrong: at least one bit of the blob has changed.
 */
#define POEGP_BLOB_CRC_MISMATCH 106

/*
 The checksum is right, but the payload of the blob cannot be read: another program wrote it.
 */
#define POEGP_BLOB_MALFORMED 107

/*
 The chain has no joints, too many, or the wrong number of frames.
 */
#define POEGP_MODEL_CHAIN 201

/*
 A fixed frame is not a rigid transform of at most 100 m.
 */
#define POEGP_MODEL_FRAME 202

/*
 The joint coupling is not a usable matrix.
 */
#define POEGP_MODEL_COUPLING 203

/*
 The limits of a joint are reversed.
 */
#define POEGP_MODEL_JOINT_LIMITS 204

/*
 A training range is missing, reversed or unbounded.
 */
#define POEGP_MODEL_RANGES 205

/*
 The number of inputs of the correction does not match the joints and the payload.
 */
#define POEGP_MODEL_INPUTS 206

/*
 A coefficient of the kernel is not usable.
 */
#define POEGP_MODEL_KERNEL 207

/*
 The correction limit is not usable.
 */
#define POEGP_MODEL_CORRECTION_LIMIT 208

/*
 The bytes of the inducing points are not a whole number of rows.
 */
#define POEGP_MODEL_PARTIAL_ROW 209

/*
 The model has more inducing points than fit into its memory.
 */
#define POEGP_MODEL_INDUCING_POINTS_TOO_LARGE 210

/*
 A number in an inducing point is not usable.
 */
#define POEGP_MODEL_ROW 211

/*
 The gravity terms do not fit the number of joints.
 */
#define POEGP_MODEL_GRAVITY 212

/*
 A gear ripple term is not usable.
 */
#define POEGP_MODEL_RIPPLE 213

/*
 The payload groups do not add up to the inducing points.
 */
#define POEGP_MODEL_GROUPS 214

/*
 The position variance is not usable.
 */
#define POEGP_MODEL_VARIANCE 215

/*
 The own-joint curves are not usable.
 */
#define POEGP_MODEL_CURVE 216

/*
 The envelope of the blob is damaged, whether or not the blob is signed.
 */
#define POEGP_SIGNATURE_MALFORMED 301

/*
 The blob is not signed.
 */
#define POEGP_SIGNATURE_UNSIGNED 302

/*
 The blob is signed by another key.
 */
#define POEGP_SIGNATURE_WRONG_KEY 303

/*
 The signature is not by this key over these bytes, or the key is not a valid public key.
 */
#define POEGP_SIGNATURE_INVALID 304

/*
 The period is not between 50 us and 0.1 s.
 */
#define POEGP_FILTER_PERIOD 401

/*
 The rate limit is not between 1e-4 and 1 rad/s, or in single precision less than 15 nrad in a period.
 */
#define POEGP_FILTER_RATE 402

/*
 The acceleration limit is not between 1e-3 and 100 rad/s^2.
 */
#define POEGP_FILTER_ACCELERATION 403

/*
 The blend time is not between 0.01 s and 10 s, or is shorter than ten periods.
 */
#define POEGP_FILTER_BLEND 404

/*
 A filter in memory of the caller, created by `poegp_filter_init` or `poegp_filter_init_f64`. It keeps the
 correction from stepping. Its contents are opaque to C.

 Each arm needs its own filter, which belongs to the thread or interrupt that commands the arm.
 */
typedef struct poegp_filter_t poegp_filter_t;

/*
 A filter in memory of the caller, created by `poegp_filter_init` or `poegp_filter_init_f64`. It keeps the
 correction from stepping. Its contents are opaque to C.

 Each arm needs its own filter, which belongs to the thread or interrupt that commands the arm.
 */
typedef struct poegp_filter_f64_t poegp_filter_f64_t;

/*
 A model in memory of the caller, created by `poegp_init` or `poegp_init_f64`. Its contents are opaque to C.

 Initialising or loading a model needs exclusive access to it; meanwhile any number of threads or interrupts may
 evaluate another model. Any number of threads or interrupts may evaluate one model at the same time.
 */
typedef struct poegp_model_t poegp_model_t;

/*
 A model in memory of the caller, created by `poegp_init` or `poegp_init_f64`. Its contents are opaque to C.

 Initialising or loading a model needs exclusive access to it; meanwhile any number of threads or interrupts may
 evaluate another model. Any number of threads or interrupts may evaluate one model at the same time.
 */
typedef struct poegp_model_f64_t poegp_model_f64_t;

/*
 The answer of `poegp_evaluate` and `poegp_evaluate_f64`.
 */
typedef struct poegp_evaluation_t {
  /*
   Compensated transform from the target frame to the base frame: a 3x4 matrix [R | t] in row-major order,
   translation in metres.
   */
  float base_from_target[12];
  /*
   Correction after limiting, as a twist in the base frame: v in metres, then omega in radians.
   */
  float correction[6];
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_evaluation_t;

/*
 The answer of `poegp_correct` and `poegp_correct_f64`.
 */
typedef struct poegp_corrected_t {
  /*
   Joints to command, in rad or m, as many as in the command; the remaining elements are zero. If nothing was
   corrected, these are the joints of the command, with zero in place of numbers that are not finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   Share of the arm's error that is corrected, 0 to 1. It is 1 except near singularities and where a bound acts.
   */
  float applied;
  /*
   Remaining position error in metres: the distance, according to the model, between the arm at these joints and
   the nominal arm at the command.
   */
  float position_error;
  /*
   Remaining rotation error in radians, according to the model, between the arm at these joints and the nominal arm
   at the command.
   */
  float rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_corrected_t;

/*
 The answer of `poegp_forward` and `poegp_forward_f64`.
 */
typedef struct poegp_forward_t {
  /*
   Transform from the tool frame to the base frame: a 3x4 matrix [R | t] in row-major order, translation in metres.
   R is orthonormal to 1e-6, plus the deviation of the R of `target_from_tool`.
   */
  float base_from_tool[12];
  /*
   Extrapolation score: 1 within the trained ranges, falling to 0 outside.
   */
  float trust;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_forward_t;

/*
 The answer of `poegp_inverse` and `poegp_inverse_f64`.
 */
typedef struct poegp_inverse_t {
  /*
   Joints to command, in rad or m, as many as in the seed; the remaining elements are zero. Always finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   Distance in metres between the requested pose and the pose of the tool at these joints.
   */
  float position_error;
  /*
   Rotation in radians between the requested pose and the pose of the tool at these joints.
   */
  float rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report. POEGP_STATUS_PARTLY_CORRECTED: the
   pose was not reached within 5 um and 5 urad.
   */
  uint32_t status;
} poegp_inverse_t;

/*
 The answer of `poegp_jacobian` and `poegp_jacobian_f64`.
 */
typedef struct poegp_jacobian_t {
  /*
   The Jacobian in row-major order, with one column for each joint; the remaining columns are zero. Rows 0 to 2 are
   the velocity of the tool's origin in m, rows 3 to 5 the angular velocity in rad, both per rad or m of the joint
   and along the x, y and z axes of the base.
   */
  float rows[6][POEGP_MAX_JOINTS];
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_jacobian_t;

/*
 The answer of `poegp_identify`.
 */
typedef struct poegp_identity_t {
  /*
   Version of the library, as zero-terminated text.
   */
  char version[POEGP_NAME_BYTES];
  /*
   Name of the robot, zero-terminated UTF-8; empty without a model. At most 32 bytes of the name in the blob.
   */
  char robot[POEGP_NAME_BYTES];
  /*
   Serial number of the arm, zero-terminated UTF-8; empty without a model. At most 32 bytes of that in the blob.
   */
  char serial_number[POEGP_NAME_BYTES];
  /*
   CRC in the header of the blob; 0 without a model.
   */
  uint32_t blob_crc;
  /*
   Number of joints of the arm; 0 without a model.
   */
  uint32_t joints;
  /*
   Number of inducing points of the correction.
   */
  uint32_t inducing_points;
  /*
   1 if the signature of the blob was verified, else 0.
   */
  uint32_t is_signed;
  /*
   Revision under the signature; 0 if there is none. A lower revision than before may be a replayed old model.
   */
  uint32_t revision;
  /*
   Warnings about the measurements that the model was calibrated with: bit i is set for cause i, which
   `poegp_warning_text` describes. 0 if there are none.
   */
  uint32_t warnings;
} poegp_identity_t;

/*
 Limits and times of a filter. For sliding joints read m for rad. `poegp_filter_defaults` stores the default
 settings.
 */
typedef struct poegp_filter_settings_t {
  /*
   Time between two commands, in s: 50 us to 0.1 s.
   */
  float period_s;
  /*
   Largest rate of the correction beyond what the motion of the command explains, in rad/s: 1e-4 to 1.
   */
  float rate;
  /*
   Largest acceleration of the correction beyond what the motion of the command explains, in rad/s^2: 1e-3 to 100.
   */
  float acceleration;
  /*
   Shortest time in which the correction is switched on or off, or the payload changes, in s: 0.01 to 10, and at
   least ten periods.
   */
  float blend_s;
} poegp_filter_settings_t;

/*
 The answer of `poegp_command` and `poegp_command_f64`.
 */
typedef struct poegp_commanded_t {
  /*
   Joints to send, in rad or m, as many as in the command; the remaining elements are zero. Always finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   Weight of the correction, from 0 (switched off) to 1 (fully switched on).
   */
  float weight;
  /*
   Share of the arm's error, 0 to 1, that the corrected command removes, as reported by `poegp_correct`. While the
   correction is on, the joints to send go to the corrected command.
   */
  float applied;
  /*
   Remaining position error of the corrected command, in metres, as reported by `poegp_correct`.
   */
  float position_error;
  /*
   Remaining rotation error of the corrected command, in radians, as reported by `poegp_correct`.
   */
  float rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_commanded_t;

/*
 Events that a filter has counted since `poegp_filter_init`, each up to 2^32 - 1.
 */
typedef struct poegp_filter_counts_t {
  /*
   Commands that jumped.
   */
  uint32_t held;
  /*
   Commands after a gap of more than five cycles.
   */
  uint32_t lost;
  /*
   Calls in a cycle that was already answered.
   */
  uint32_t doubled;
  /*
   Invalid commands, for which the last joints were sent again.
   */
  uint32_t bad;
  /*
   Commands whose correction changed more than their motion explains, without a jump, a gap or a change of payload:
   the model was exchanged, or its correction steps.
   */
  uint32_t guarded;
} poegp_filter_counts_t;

/*
 The answer of a device to the cyclic frame of a command.
 */
typedef struct poegp_cyclic_answer_t {
  /*
   Joints to send, in rad or m; elements beyond `joint_count` are zero. Always finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   Number of joints, as many as in the command.
   */
  uint32_t joint_count;
  /*
   Sequence number of the command that is answered.
   */
  uint32_t sequence;
  /*
   Share of the arm's error, 0 to 1, that the model removes while the correction is on.
   */
  float applied;
  /*
   Position error that remains while the correction is on, in metres.
   */
  float position_error;
  /*
   Rotation error that remains while the correction is on, in radians.
   */
  float rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_cyclic_answer_t;

/*
 The answer of `poegp_evaluate` and `poegp_evaluate_f64`.
 */
typedef struct poegp_evaluation_f64_t {
  /*
   Compensated transform from the target frame to the base frame: a 3x4 matrix [R | t] in row-major order,
   translation in metres.
   */
  double base_from_target[12];
  /*
   Correction after limiting, as a twist in the base frame: v in metres, then omega in radians.
   */
  double correction[6];
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_evaluation_f64_t;

/*
 The answer of `poegp_correct` and `poegp_correct_f64`.
 */
typedef struct poegp_corrected_f64_t {
  /*
   Joints to command, in rad or m, as many as in the command; the remaining elements are zero. If nothing was
   corrected, these are the joints of the command, with zero in place of numbers that are not finite.
   */
  double joints[POEGP_MAX_JOINTS];
  /*
   Share of the arm's error that is corrected, 0 to 1. It is 1 except near singularities and where a bound acts.
   */
  double applied;
  /*
   Remaining position error in metres: the distance, according to the model, between the arm at these joints and
   the nominal arm at the command.
   */
  double position_error;
  /*
   Remaining rotation error in radians, according to the model, between the arm at these joints and the nominal arm
   at the command.
   */
  double rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_corrected_f64_t;

/*
 The answer of `poegp_forward` and `poegp_forward_f64`.
 */
typedef struct poegp_forward_f64_t {
  /*
   Transform from the tool frame to the base frame: a 3x4 matrix [R | t] in row-major order, translation in metres.
   R is orthonormal to 1e-6, plus the deviation of the R of `target_from_tool`.
   */
  double base_from_tool[12];
  /*
   Extrapolation score: 1 within the trained ranges, falling to 0 outside.
   */
  double trust;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_forward_f64_t;

/*
 The answer of `poegp_inverse` and `poegp_inverse_f64`.
 */
typedef struct poegp_inverse_f64_t {
  /*
   Joints to command, in rad or m, as many as in the seed; the remaining elements are zero. Always finite.
   */
  double joints[POEGP_MAX_JOINTS];
  /*
   Distance in metres between the requested pose and the pose of the tool at these joints.
   */
  double position_error;
  /*
   Rotation in radians between the requested pose and the pose of the tool at these joints.
   */
  double rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report. POEGP_STATUS_PARTLY_CORRECTED: the
   pose was not reached within 5 um and 5 urad.
   */
  uint32_t status;
} poegp_inverse_f64_t;

/*
 The answer of `poegp_jacobian` and `poegp_jacobian_f64`.
 */
typedef struct poegp_jacobian_f64_t {
  /*
   The Jacobian in row-major order, with one column for each joint; the remaining columns are zero. Rows 0 to 2 are
   the velocity of the tool's origin in m, rows 3 to 5 the angular velocity in rad, both per rad or m of the joint
   and along the x, y and z axes of the base.
   */
  double rows[6][POEGP_MAX_JOINTS];
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_jacobian_f64_t;

/*
 Limits and times of a filter. For sliding joints read m for rad. `poegp_filter_defaults` stores the default
 settings.
 */
typedef struct poegp_filter_settings_f64_t {
  /*
   Time between two commands, in s: 50 us to 0.1 s.
   */
  double period_s;
  /*
   Largest rate of the correction beyond what the motion of the command explains, in rad/s: 1e-4 to 1.
   */
  double rate;
  /*
   Largest acceleration of the correction beyond what the motion of the command explains, in rad/s^2: 1e-3 to 100.
   */
  double acceleration;
  /*
   Shortest time in which the correction is switched on or off, or the payload changes, in s: 0.01 to 10, and at
   least ten periods.
   */
  double blend_s;
} poegp_filter_settings_f64_t;

/*
 The answer of `poegp_command` and `poegp_command_f64`.
 */
typedef struct poegp_commanded_f64_t {
  /*
   Joints to send, in rad or m, as many as in the command; the remaining elements are zero. Always finite.
   */
  double joints[POEGP_MAX_JOINTS];
  /*
   Weight of the correction, from 0 (switched off) to 1 (fully switched on).
   */
  double weight;
  /*
   Share of the arm's error, 0 to 1, that the corrected command removes, as reported by `poegp_correct`. While the
   correction is on, the joints to send go to the corrected command.
   */
  double applied;
  /*
   Remaining position error of the corrected command, in metres, as reported by `poegp_correct`.
   */
  double position_error;
  /*
   Remaining rotation error of the corrected command, in radians, as reported by `poegp_correct`.
   */
  double rotation_error;
  /*
   Status: a combination of POEGP_STATUS_ bits; 0 if there is nothing to report.
   */
  uint32_t status;
} poegp_commanded_f64_t;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Returns the size of a model in this build of the library, in bytes; at most POEGP_MODEL_BYTES.
 */
size_t poegp_model_size(void);

/*
 Returns the alignment of a model in bytes, POEGP_MODEL_ALIGN.
 */
size_t poegp_model_align(void);

/*
 Returns the POEGP_API_VERSION that the library was built with. If it differs from that of the header, do not use
 the library.
 */
uint32_t poegp_api_version(void);

/*
 Creates an empty model in the `bytes` bytes at `memory`, which must be aligned to POEGP_MODEL_ALIGN, and stores
 its address in `*model`, or null if it returns an error. The memory belongs to the model until the model is no
 longer used; nothing has to be freed.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP.

 # Safety
 `memory` points to `bytes` bytes that nobody else uses, `model` to a pointer.
 */
int32_t poegp_init(void *memory,
                   size_t bytes,
                   struct poegp_model_t **model);

/*
 Verifies a blob completely and loads its model, all or nothing: after an error the last good model stays. The
 blob is copied and need not be kept. Loading takes up to 20 kB of stack and more time than a control cycle has:
 load into a second model while the first one is still evaluated.

 Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_MODEL_ codes.

 # Safety
 `model` comes from `poegp_init` and nobody else uses it during the call; `blob` points to `length` bytes.
 */
int32_t poegp_load(struct poegp_model_t *model,
                   const uint8_t *blob,
                   size_t length);

/*
 Loads a blob as `poegp_load` does, but refuses it unless it is signed by the Ed25519 key `public_key` of 32
 bytes. Takes a few kilobytes more of stack, and millions of instructions.

 Errors: those of `poegp_load`, and POEGP_SIGNATURE_ codes.

 # Safety
 As for `poegp_load`; `public_key` points to 32 bytes.
 */
int32_t poegp_load_signed(struct poegp_model_t *model,
                          const uint8_t *blob,
                          size_t length,
                          const uint8_t *public_key);

/*
 Checks whether a blob is intact and signed by the Ed25519 key `public_key` of 32 bytes. Needs no model.

 Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_SIGNATURE_ codes.

 # Safety
 `blob` points to `length` bytes, `public_key` to 32.
 */
int32_t poegp_verify(const uint8_t *blob, size_t length, const uint8_t *public_key);

/*
 Computes the actual pose of the target for `count` joints in rad or m and a payload in kg (0 if the model knows
 no payload). The execution time does not depend on the values. `joints` may lie in `*out`.

 Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
 trusted. With an error code the answer is the identity and its status has POEGP_STATUS_NO_MODEL or
 POEGP_STATUS_BAD_INPUT, unless `out` itself cannot be used.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
 POEGP_ERROR_JOINTS.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `joints` points to `count` numbers; `out`
 points to memory of the caller.
 */
int32_t poegp_evaluate(const struct poegp_model_t *model,
                       const float *joints,
                       size_t count,
                       float payload_kg,
                       struct poegp_evaluation_t *out);

/*
 Computes the joints to command so that the real arm stands where the nominal arm would stand at `joints` (rad or
 m), with a payload in kg. No joint changes by more than 0.1 rad or m. The answer is a continuous function of
 joints and payload and depends on nothing else: to switch the correction on, or to exchange the model, while the
 arm moves, see `poegp_command`. `joints` may lie in `*out`.

 Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
 trusted. With an error code the answer is the uncorrected command, as far as it could be read, and its status
 has POEGP_STATUS_NO_MODEL or POEGP_STATUS_BAD_INPUT, unless `out` itself cannot be used.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
 POEGP_ERROR_JOINTS.

 # Safety
 As for `poegp_evaluate`.
 */
int32_t poegp_correct(const struct poegp_model_t *model,
                      const float *joints,
                      size_t count,
                      float payload_kg,
                      struct poegp_corrected_t *out);

/*
 Computes the pose of a tool on the calibrated arm, for `count` joints in rad or m and a payload in kg (0 if the
 model knows no payload). `target_from_tool` is the pose of the tool relative to the target that was measured:
 twelve numbers, a 3x4 matrix [R | t] in row-major order, translation in metres; R must be orthonormal within
 1e-3. Null stands for the target itself. `joints` and `target_from_tool` may lie in `*out`.

 `poegp_evaluate` computes the pose of the target only, and also returns the correction.

 Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
 trusted. The answer is the identity with an error code, without a model, and for joints or a tool that cannot be
 used (POEGP_STATUS_BAD_INPUT).

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
 POEGP_ERROR_JOINTS.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `joints` points to `count` numbers,
 `target_from_tool` to twelve if it is not null; `out` points to memory of the caller.
 */
int32_t poegp_forward(const struct poegp_model_t *model,
                      const float *target_from_tool,
                      const float *joints,
                      size_t count,
                      float payload_kg,
                      struct poegp_forward_t *out);

/*
 Computes the joints to command so that the tool of the calibrated arm is at `base_from_tool`, with a payload in
 kg. This is the inverse of `poegp_forward`, on the branch of the `count` joints at `seed`: in a control cycle,
 the joints that were sent last. Both poses are twelve numbers, a 3x4 matrix [R | t] in row-major order,
 translation in metres; each R must be orthonormal within 1e-3. `target_from_tool` is as for `poegp_forward`.
 `seed` and both poses may lie in `*out`.

 The answer is never farther from the requested pose than the seed. If the pose is not reached, because it is
 beyond the arm's reach or near a singularity, the status has POEGP_STATUS_PARTLY_CORRECTED and the errors in the
 answer say by how much. Joint limits are not checked. The search takes a few evaluations from a near seed, and
 at most 61 from any seed.

 At 1 kHz, the rounding of `float` joints causes noise of 0.4 rad/s^2 in their accelerations. Use
 `poegp_inverse_f64` if joints are sent as `double`.

 Returns POEGP_OK for all numbers, NaN and infinity included. With an error code, without a model, and for bad
 input (POEGP_STATUS_BAD_INPUT) the answer is the seed as far as it could be read, with zero in place of numbers
 that are not finite.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
 POEGP_ERROR_JOINTS.

 # Safety
 As for `poegp_forward`; `base_from_tool` points to twelve numbers, `seed` to `count`.
 */
int32_t poegp_inverse(const struct poegp_model_t *model,
                      const float *target_from_tool,
                      const float *base_from_tool,
                      const float *seed,
                      size_t count,
                      float payload_kg,
                      struct poegp_inverse_t *out);

/*
 Computes the Jacobian of the calibrated arm: how the tool moves with each of the `count` joints (rad or m), with
 a payload in kg. The arguments are as for `poegp_forward`.

 The reference point is the tool's origin and the axes are those of the base. The rows are linear velocity, then
 angular velocity, as in Pinocchio's LOCAL_WORLD_ALIGNED. The columns are the controller's joints; a joint
 coupling is included.

 The Jacobian is that of the calibrated chain at the controller's joints, with the reference point where the
 whole model locates the tool. The derivative of the correction is left out. Numerical differences of
 `poegp_forward_f64` therefore deviate from it: for an elastic model of an arm of 2 m by 0.001 m or rad per rad
 (root mean square), and by 0.0024 at most.

 Returns POEGP_OK for all numbers, NaN and infinity included. With an error code, without a model, and for bad
 input (POEGP_STATUS_BAD_INPUT) all columns are zero.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
 POEGP_ERROR_JOINTS.

 # Safety
 As for `poegp_forward`.
 */
int32_t poegp_jacobian(const struct poegp_model_t *model,
                       const float *target_from_tool,
                       const float *joints,
                       size_t count,
                       float payload_kg,
                       struct poegp_jacobian_t *out);

/*
 Reads which arm the model describes. Without a model the names are empty and the numbers are zero.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `out` points to memory of the caller.
 */
int32_t poegp_identify(const struct poegp_model_t *model, struct poegp_identity_t *out);

/*
 Returns the meaning of a code as zero-terminated text, which need not be freed. Never null.
 */
const char *poegp_error_text(int32_t code);

/*
 Returns the cause of a warning as zero-terminated text, which need not be freed. Never null. `bit` is the number
 of its bit in `poegp_identity_t.warnings`.
 */
const char *poegp_warning_text(uint32_t bit);

/*
 Returns the size of a filter in this build of the library, in bytes; at most POEGP_FILTER_BYTES.
 */
size_t poegp_filter_size(void);

/*
 Returns the alignment of a filter in bytes, POEGP_FILTER_ALIGN.
 */
size_t poegp_filter_align(void);

/*
 Stores the default settings for a time of `period_s` seconds between two commands: rate 20 mrad/s, acceleration
 0.5 rad/s^2, blend time 0.5 s.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED.

 # Safety
 `settings` points to memory of the caller.
 */
int32_t poegp_filter_defaults(float period_s,
                              struct poegp_filter_settings_t *settings);

/*
 Creates a filter in the `bytes` bytes at `memory`, which must be aligned to POEGP_FILTER_ALIGN, and stores its
 address in `*filter`, or null if it returns an error. The memory belongs to the filter until the filter is no
 longer used; nothing has to be freed. To change the settings, create the filter again while it is disengaged.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP, POEGP_FILTER_
 codes.

 # Safety
 `memory` points to `bytes` bytes that nobody else uses, `settings` to settings, `filter` to a pointer.
 */
int32_t poegp_filter_init(void *memory,
                          size_t bytes,
                          const struct poegp_filter_settings_t *settings,
                          struct poegp_filter_t **filter);

/*
 Computes the joints to send for a command of `count` joints (rad or m) and a payload in kg. Call it once in
 every cycle. It corrects as `poegp_correct` does, but the joints to send do not step when the correction is
 switched on or off, the payload changes, a command is lost or the model is exchanged: every change of the
 correction that the motion of the command does not explain stays within the limits of the filter. The execution
 time does not depend on the values of a valid command. `joints` may lie in `*out`. With a model of another
 number of joints, the first command of that `count` resets the filter.

 `engage`: 0 requests the command itself (POEGP_STATUS_BYPASSED), any other value the corrected command. During
 the transition from one to the other the status has POEGP_STATUS_BLENDING. After it, the joints are bit for bit
 those of `poegp_correct` or those of the command, whatever the model and the payload are.
 `cycles`: number of cycles since the last call, 1 if none was left out; 0 for another answer to the same
 request. However many they are, the correction goes on by one cycle.

 Returns POEGP_OK for all numbers, NaN and infinity included; `out->status` says how far the answer can be
 trusted. In place of a bad payload the last good one is used. Other bad input is answered with the joints that were
 sent last; joints that were never sent are those of the command, with zero in place of numbers that are not finite.
 While `engage` is 0, what only the model refuses, such as the payload, is not bad: the correction goes to zero. With
 an error code the answer depends on the argument that is wrong:
 - `joints`, or `count` (zero, above POEGP_MAX_JOINTS, another than that of the model or, without a model, than that
   of the last command): the same as for bad input, with POEGP_STATUS_BAD_INPUT, and always all joints that were
   sent last. Only the `count` of the last command passes while `engage` is 0, also with a model of another number;
 - `model`: joints whose correction goes to zero within the limits, with POEGP_STATUS_NO_MODEL;
 - `filter`: the uncorrected command, which may be a step, with POEGP_STATUS_BAD_INPUT;
 - `out`: no answer, and the filter is unchanged, as if it had not been called.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP,
 POEGP_ERROR_JOINTS.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `filter` comes from `poegp_filter_init` and
 nobody else uses it during the call; `joints` points to `count` numbers; `out` points to memory of the caller.
 */
int32_t poegp_command(const struct poegp_model_t *model,
                      struct poegp_filter_t *filter,
                      const float *joints,
                      size_t count,
                      float payload_kg,
                      int32_t engage,
                      uint32_t cycles,
                      struct poegp_commanded_t *out);

/*
 Returns 1 if the weight of the correction is 0 and does not change, and no offset of an earlier correction is left:
 only then exchange the model or create the filter again. Otherwise returns 0, also if `filter` is not a filter.
 While `engage` is not 0 the weight goes to 1, even without a model.

 # Safety
 `filter` comes from `poegp_filter_init` and nobody changes it during the call.
 */
int32_t poegp_filter_disengaged(const struct poegp_filter_t *filter);

/*
 Reads the events that the filter has counted. With an error code all counts are zero.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `filter` comes from `poegp_filter_init` and nobody changes it during the call; `out` points to memory of the
 caller.
 */
int32_t poegp_filter_counts(const struct poegp_filter_t *filter, struct poegp_filter_counts_t *out);

/*
 Makes the filter forget commands, correction and payload; its settings and counts stay. The correction steps to
 zero unless the filter is disengaged: use this for an arm that stands still with its brakes on.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED.

 # Safety
 `filter` comes from `poegp_filter_init` and nobody else uses it during the call.
 */
int32_t poegp_filter_reset(struct poegp_filter_t *filter);

/*
 Writes the cyclic frame of a command for a device: `count` joints (rad or m) and a payload in kg, with a
 `sequence` number that differs from cycle to cycle. Send the first `*length` bytes at `frame`, 37 for six
 joints; the last of them is a zero. The function computes nothing and checks no values; it is the device
 that answers numbers that are not finite.

 Errors, with `*length` set to zero if it can be written: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED,
 POEGP_ERROR_JOINTS, POEGP_ERROR_OVERLAP.

 # Safety
 `joints` points to `count` numbers, `frame` to POEGP_CYCLIC_BYTES bytes of the caller, `length` to a number of
 the caller.
 */
int32_t poegp_cyclic_command(uint16_t sequence,
                             const float *joints,
                             size_t count,
                             float payload_kg,
                             uint8_t *frame,
                             size_t *length);

/*
 Reads the answer of a device from the `length` bytes that were received up to a zero, with or without that zero.
 With an error code nothing is written to `*out`. Read on until an answer has the `sequence` of the command: an
 earlier one may have come late. If none comes in time, send the present command plus the correction of the last
 answer, and withdraw that slowly (docs/reference/link.md, "No answer in time").

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_LENGTH, POEGP_ERROR_FRAME.

 # Safety
 `frame` points to `length` bytes, `out` to memory of the caller.
 */
int32_t poegp_cyclic_answer(const uint8_t *frame,
                            size_t length,
                            struct poegp_cyclic_answer_t *out);

/*
 Double-precision version of `poegp_model_size`; returns at most POEGP_MODEL_F64_BYTES.
 */
size_t poegp_model_size_f64(void);

/*
 Double-precision version of `poegp_filter_size`; returns at most POEGP_FILTER_F64_BYTES.
 */
size_t poegp_filter_size_f64(void);

/*
 Double-precision version of `poegp_init`. The model takes POEGP_MODEL_F64_BYTES of memory.

 # Safety
 As for `poegp_init`.
 */
int32_t poegp_init_f64(void *memory, size_t bytes, struct poegp_model_f64_t **model);

/*
 Double-precision version of `poegp_load`. Takes the same blobs.

 # Safety
 As for `poegp_load`.
 */
int32_t poegp_load_f64(struct poegp_model_f64_t *model, const uint8_t *blob, size_t length);

/*
 Double-precision version of `poegp_load_signed`. Takes the same blobs.

 # Safety
 As for `poegp_load_signed`.
 */
int32_t poegp_load_signed_f64(struct poegp_model_f64_t *model,
                              const uint8_t *blob,
                              size_t length,
                              const uint8_t *public_key);

/*
 Double-precision version of `poegp_identify`.

 # Safety
 As for `poegp_identify`.
 */
int32_t poegp_identify_f64(const struct poegp_model_f64_t *model, struct poegp_identity_t *out);

/*
 Double-precision version of `poegp_evaluate`.

 # Safety
 As for `poegp_evaluate`.
 */
int32_t poegp_evaluate_f64(const struct poegp_model_f64_t *model,
                           const double *joints,
                           size_t count,
                           double payload_kg,
                           struct poegp_evaluation_f64_t *out);

/*
 Double-precision version of `poegp_correct`.

 # Safety
 As for `poegp_correct`.
 */
int32_t poegp_correct_f64(const struct poegp_model_f64_t *model,
                          const double *joints,
                          size_t count,
                          double payload_kg,
                          struct poegp_corrected_f64_t *out);

/*
 Double-precision version of `poegp_forward`.

 # Safety
 As for `poegp_forward`.
 */
int32_t poegp_forward_f64(const struct poegp_model_f64_t *model,
                          const double *target_from_tool,
                          const double *joints,
                          size_t count,
                          double payload_kg,
                          struct poegp_forward_f64_t *out);

/*
 Double-precision version of `poegp_inverse`. It reaches the pose to 1e-12 m and rad, and at 1 kHz rounding adds
 less than 0.0001 rad/s^2 to the accelerations of a smooth path.

 # Safety
 As for `poegp_inverse`.
 */
int32_t poegp_inverse_f64(const struct poegp_model_f64_t *model,
                          const double *target_from_tool,
                          const double *base_from_tool,
                          const double *seed,
                          size_t count,
                          double payload_kg,
                          struct poegp_inverse_f64_t *out);

/*
 Double-precision version of `poegp_jacobian`.

 # Safety
 As for `poegp_jacobian`.
 */
int32_t poegp_jacobian_f64(const struct poegp_model_f64_t *model,
                           const double *target_from_tool,
                           const double *joints,
                           size_t count,
                           double payload_kg,
                           struct poegp_jacobian_f64_t *out);

/*
 Double-precision version of `poegp_filter_defaults`.

 # Safety
 As for `poegp_filter_defaults`.
 */
int32_t poegp_filter_defaults_f64(double period_s, struct poegp_filter_settings_f64_t *settings);

/*
 Double-precision version of `poegp_filter_init`. The filter takes POEGP_FILTER_F64_BYTES of memory.

 # Safety
 As for `poegp_filter_init`.
 */
int32_t poegp_filter_init_f64(void *memory,
                              size_t bytes,
                              const struct poegp_filter_settings_f64_t *settings,
                              struct poegp_filter_f64_t **filter);

/*
 Double-precision version of `poegp_command`.

 # Safety
 As for `poegp_command`.
 */
int32_t poegp_command_f64(const struct poegp_model_f64_t *model,
                          struct poegp_filter_f64_t *filter,
                          const double *joints,
                          size_t count,
                          double payload_kg,
                          int32_t engage,
                          uint32_t cycles,
                          struct poegp_commanded_f64_t *out);

/*
 Double-precision version of `poegp_filter_disengaged`.

 # Safety
 As for `poegp_filter_disengaged`.
 */
int32_t poegp_filter_disengaged_f64(const struct poegp_filter_f64_t *filter);

/*
 Double-precision version of `poegp_filter_counts`.

 # Safety
 As for `poegp_filter_counts`.
 */
int32_t poegp_filter_counts_f64(const struct poegp_filter_f64_t *filter, struct poegp_filter_counts_t *out);

/*
 Double-precision version of `poegp_filter_reset`.

 # Safety
 As for `poegp_filter_reset`.
 */
int32_t poegp_filter_reset_f64(struct poegp_filter_f64_t *filter);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* POEGP_H */
