/* Calibrated robot arms for programs in C. README.md beside this folder says how to link and how to use it.

   Generated from the Rust sources; do not edit (tests/header.rs). Units are radians, metres and kilograms. Of every
   pointer the library refuses what it can see (null, misaligned, overlapping); that as much memory is there as is
   said (# Safety) is the promise of the caller. */

#ifndef POEGP_H
#define POEGP_H

#include <stddef.h>
#include <stdint.h>

/*
 Changes when a function, a structure or the meaning of a code does; see `poegp_api_version`.
 */
#define POEGP_API_VERSION 4

/*
 Most joints of an arm.
 */
#define POEGP_MAX_JOINTS 8

/*
 Bytes of a name in `poegp_identity_t`, its final zero included.
 */
#define POEGP_NAME_BYTES 36

/*
 Bytes of memory for one model, enough on 32-bit and 64-bit machines.
 */
#define POEGP_MODEL_BYTES 27648

/*
 Alignment of the memory for a model, of either precision, in bytes.
 */
#define POEGP_MODEL_ALIGN 8

/*
 Bytes of memory for one filter, enough on 32-bit and 64-bit machines.
 */
#define POEGP_FILTER_BYTES 320

/*
 Alignment of the memory for a filter, of either precision, in bytes.
 */
#define POEGP_FILTER_ALIGN 8

/*
 Bytes of memory for one model in double precision.
 */
#define POEGP_MODEL_F64_BYTES 55296

/*
 Bytes of memory for one filter in double precision.
 */
#define POEGP_FILTER_F64_BYTES 640

/*
 Most bytes of a cyclic frame.
 */
#define POEGP_CYCLIC_BYTES 54

/*
 Status bit: some joint is outside the range that was trained; the correction is an extrapolation.
 */
#define POEGP_STATUS_OUTSIDE_JOINT_RANGE 1

/*
 Status bit: the payload is outside the range that was trained.
 */
#define POEGP_STATUS_OUTSIDE_PAYLOAD_RANGE 2

/*
 Status bit: the correction exceeded the bound of the blob and was scaled back to it.
 */
#define POEGP_STATUS_CORRECTION_LIMITED 4

/*
 Status bit: there is no model. The pose is the identity, the joints are those of the command.
 */
#define POEGP_STATUS_NO_MODEL 8

/*
 Status bit: wrong number of joints, a number that is not finite, or one beyond all reason: nothing was corrected.
 */
#define POEGP_STATUS_BAD_INPUT 16

/*
 Status bit: more than 5 um or 5 urad of the arm's error stay by the model: beside a singularity, or because a bound
 acts.
 */
#define POEGP_STATUS_PARTLY_CORRECTED 32

/*
 Status bit of `poegp_command`: the correction is switched off; the command itself goes out, or will soon.
 */
#define POEGP_STATUS_BYPASSED 64

/*
 Status bit of `poegp_command`: the joints are on their way to those that were asked for.
 */
#define POEGP_STATUS_BLENDING 128

/*
 Done.
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
 The memory is smaller than a model or a filter.
 */
#define POEGP_ERROR_TOO_SMALL 3

/*
 The memory was not initialised by `poegp_init`, or `poegp_filter_init`.
 */
#define POEGP_ERROR_NOT_INITIALISED 4

/*
 Two arguments share memory that must not.
 */
#define POEGP_ERROR_OVERLAP 5

/*
 A length is larger than the memory of the machine.
 */
#define POEGP_ERROR_LENGTH 6

/*
 The bytes are no answer in a cyclic frame: damaged, another message, or a number that is not finite.
 */
#define POEGP_ERROR_FRAME 7

/*
 No joint, or more than POEGP_MAX_JOINTS.
 */
#define POEGP_ERROR_JOINTS 8

/*
 Something else; later versions of the runtime may have reasons that this one has no number for.
 */
#define POEGP_ERROR_OTHER 99

/*
 Fewer bytes than the blob announces.
 */
#define POEGP_BLOB_TRUNCATED 101

/*
 Not a model blob: it does not begin with POEGPARM.
 */
#define POEGP_BLOB_WRONG_MAGIC 102

/*
 Written in a format that this version does not know.
 */
#define POEGP_BLOB_UNKNOWN_VERSION 103

/*
 The header is damaged.
 */
#define POEGP_BLOB_RESERVED_BITS 104

/*
 More bytes than the blob announces.
 */
#define POEGP_BLOB_TRAILING_BYTES 105

/*
 Some bit has changed.
 */
#define POEGP_BLOB_CRC_MISMATCH 106

/*
 The checksum is right and the payload cannot be read: written by another program.
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
 The coupling of the joints is not a usable matrix.
 */
#define POEGP_MODEL_COUPLING 203

/*
 Joint limits are reversed.
 */
#define POEGP_MODEL_JOINT_LIMITS 204

/*
 A training range is missing, reversed or without bounds.
 */
#define POEGP_MODEL_RANGES 205

/*
 The correction has another number of inputs than joints and payload make.
 */
#define POEGP_MODEL_INPUTS 206

/*
 A coefficient of the kernel is not usable.
 */
#define POEGP_MODEL_KERNEL 207

/*
 The bound on the correction is not usable.
 */
#define POEGP_MODEL_CORRECTION_LIMIT 208

/*
 The bytes of the inducing points are not whole rows.
 */
#define POEGP_MODEL_PARTIAL_ROW 209

/*
 More inducing points than fits.
 */
#define POEGP_MODEL_INDUCING_POINTS_TOO_LARGE 210

/*
 A number of an inducing point is not usable.
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
 The variance of the position is not usable.
 */
#define POEGP_MODEL_VARIANCE 215

/*
 The own-joint curves are not usable.
 */
#define POEGP_MODEL_CURVE 216

/*
 Signed or not: the envelope is damaged.
 */
#define POEGP_SIGNATURE_MALFORMED 301

/*
 Nobody has signed the blob.
 */
#define POEGP_SIGNATURE_UNSIGNED 302

/*
 The blob is signed by another key.
 */
#define POEGP_SIGNATURE_WRONG_KEY 303

/*
 The signature is not one of these bytes by this key, or the key is none.
 */
#define POEGP_SIGNATURE_INVALID 304

/*
 The period is not within 50 us and 0.1 s.
 */
#define POEGP_FILTER_PERIOD 401

/*
 The rate limit is not within 1e-4 and 1 rad/s.
 */
#define POEGP_FILTER_RATE 402

/*
 The acceleration limit is not within 1e-3 and 100 rad/s^2.
 */
#define POEGP_FILTER_ACCELERATION 403

/*
 The blend time is not within 0.01 s and 10 s, or below ten periods.
 */
#define POEGP_FILTER_BLEND 404

/*
 A filter in the caller's memory, which keeps the correction from stepping. Made by `poegp_filter_init`, or
 `poegp_filter_init_f64`; what is in it is of no concern to C.

 One for each arm; it belongs to the thread or interrupt that commands.
 */
typedef struct poegp_filter_t poegp_filter_t;

/*
 A filter in the caller's memory, which keeps the correction from stepping. Made by `poegp_filter_init`, or
 `poegp_filter_init_f64`; what is in it is of no concern to C.

 One for each arm; it belongs to the thread or interrupt that commands.
 */
typedef struct poegp_filter_f64_t poegp_filter_f64_t;

/*
 A model in the caller's memory. Made by `poegp_init`, or `poegp_init_f64`; what is in it is of no concern to C.

 Loading and initialising need it for themselves; any number of threads or interrupts may evaluate meanwhile
 another one, or evaluate this one at the same time.
 */
typedef struct poegp_model_t poegp_model_t;

/*
 A model in the caller's memory. Made by `poegp_init`, or `poegp_init_f64`; what is in it is of no concern to C.

 Loading and initialising need it for themselves; any number of threads or interrupts may evaluate meanwhile
 another one, or evaluate this one at the same time.
 */
typedef struct poegp_model_f64_t poegp_model_f64_t;

/*
 The answer of `poegp_evaluate` and `poegp_evaluate_f64`.
 */
typedef struct poegp_evaluation_t {
  /*
   Compensated transform from the target to the base, a 3x4 matrix [R | t] row by row; metres.
   */
  float base_from_target[12];
  /*
   The correction as a twist of the base frame after bounding: v in metres, then omega in radians.
   */
  float correction[6];
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_evaluation_t;

/*
 The answer of `poegp_correct` and `poegp_correct_f64`.
 */
typedef struct poegp_corrected_t {
  /*
   Joints to command, rad or m, as many as the command had; zero beyond. The command itself when nothing was
   corrected, with zero for what is not finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   How much of the arm's error is corrected, 0 to 1: 1 but beside singularities and where a bound acts.
   */
  float applied;
  /*
   Distance in metres that stays, by the model, between the arm at these joints and the nominal one at the command.
   */
  float position_error;
  /*
   The rotation error that stays, in radians.
   */
  float rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_corrected_t;

/*
 The answer of `poegp_forward` and `poegp_forward_f64`.
 */
typedef struct poegp_forward_t {
  /*
   Transform from the tool to the base, a 3x4 matrix [R | t] row by row; metres. R is orthonormal to 1e-6.
   */
  float base_from_tool[12];
  /*
   Extrapolation score: 1 within the trained ranges, falling to 0 outside.
   */
  float trust;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_forward_t;

/*
 The answer of `poegp_inverse` and `poegp_inverse_f64`.
 */
typedef struct poegp_inverse_t {
  /*
   Joints to command, rad or m, as many as the seed had; zero beyond. Always finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   Distance in metres between the wanted pose and that of the tool at these joints.
   */
  float position_error;
  /*
   The rotation between them, in radians.
   */
  float rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark. POEGP_STATUS_PARTLY_CORRECTED: the
   pose was not reached within 5 um and 5 urad.
   */
  uint32_t status;
} poegp_inverse_t;

/*
 The answer of `poegp_jacobian` and `poegp_jacobian_f64`.
 */
typedef struct poegp_jacobian_t {
  /*
   The Jacobian row by row; one column for each joint, zeros beyond. Rows 0 to 2 are the velocity of the tool's origin in
   m, rows 3 to 5 the angular velocity in rad, per rad or m of the joint. Both are along the x, y and z axes of the base.
   */
  float rows[6][POEGP_MAX_JOINTS];
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_jacobian_t;

/*
 The answer of `poegp_identify`.
 */
typedef struct poegp_identity_t {
  /*
   Version of the library, as text that ends with a zero.
   */
  char version[POEGP_NAME_BYTES];
  /*
   Name of the robot, UTF-8 that ends with a zero; empty without a model. At most 32 bytes of the blob's name.
   */
  char robot[POEGP_NAME_BYTES];
  /*
   Serial number of the arm, the same.
   */
  char serial_number[POEGP_NAME_BYTES];
  /*
   CRC in the header of the blob; 0 without a model.
   */
  uint32_t blob_crc;
  /*
   Joints of the arm; 0 without a model.
   */
  uint32_t joints;
  /*
   Inducing points of the correction.
   */
  uint32_t inducing_points;
  /*
   1 when the signature of the blob was verified, else 0.
   */
  uint32_t is_signed;
  /*
   The revision under its signature, 0 without one: a lower one than before may be an old model that somebody plays back.
   */
  uint32_t revision;
  /*
   Warnings about the measurements that the model was calibrated with: bit i is set for cause i, which
   `poegp_warning_text` describes. 0 without warnings.
   */
  uint32_t warnings;
} poegp_identity_t;

/*
 Limits and times of a filter. For sliding joints m stands for rad. `poegp_filter_defaults` fills it.
 */
typedef struct poegp_filter_settings_t {
  /*
   Time between two commands in s, 50 us to 0.1 s.
   */
  float period_s;
  /*
   Largest rate of the correction beyond what the path explains, rad/s, 1e-4 to 1.
   */
  float rate;
  /*
   Largest acceleration of the correction beyond what the path explains, rad/s^2, 1e-3 to 100.
   */
  float acceleration;
  /*
   Shortest time in s in which the correction is switched on or off, or the payload changes; 0.01 to 10, and at least
   ten periods.
   */
  float blend_s;
} poegp_filter_settings_t;

/*
 The answer of `poegp_command` and `poegp_command_f64`.
 */
typedef struct poegp_commanded_t {
  /*
   Joints to send, rad or m, as many as the command had; zero beyond. Always finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   How far the correction is switched on, 0 to 1.
   */
  float weight;
  /*
   What `poegp_correct` says of the corrected command, to which the joints go while the correction is on: how much of
   the arm's error it takes away, 0 to 1.
   */
  float applied;
  /*
   The same: distance that stays, in metres.
   */
  float position_error;
  /*
   The same: rotation that stays, in radians.
   */
  float rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_commanded_t;

/*
 What a filter has counted since `poegp_filter_init`, each up to 2^32 - 1.
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
   Calls within a cycle that had been answered.
   */
  uint32_t doubled;
  /*
   Commands that were none; the last joints were sent again.
   */
  uint32_t bad;
  /*
   Commands whose correction changed more than the path explains, without a jump, a gap or a change of payload: the
   model was exchanged, or steps.
   */
  uint32_t guarded;
} poegp_filter_counts_t;

/*
 The answer of a device to the cyclic frame of a command.
 */
typedef struct poegp_cyclic_answer_t {
  /*
   Joints to send, rad or m; zero beyond `joint_count`. Always finite.
   */
  float joints[POEGP_MAX_JOINTS];
  /*
   As many as the command had.
   */
  uint32_t joint_count;
  /*
   That of the command.
   */
  uint32_t sequence;
  /*
   How much of the arm's error the model takes away while the correction is on, 0 to 1.
   */
  float applied;
  /*
   The same: distance that stays, in metres.
   */
  float position_error;
  /*
   The same: rotation that stays, in radians.
   */
  float rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_cyclic_answer_t;

/*
 The answer of `poegp_evaluate` and `poegp_evaluate_f64`.
 */
typedef struct poegp_evaluation_f64_t {
  /*
   Compensated transform from the target to the base, a 3x4 matrix [R | t] row by row; metres.
   */
  double base_from_target[12];
  /*
   The correction as a twist of the base frame after bounding: v in metres, then omega in radians.
   */
  double correction[6];
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_evaluation_f64_t;

/*
 The answer of `poegp_correct` and `poegp_correct_f64`.
 */
typedef struct poegp_corrected_f64_t {
  /*
   Joints to command, rad or m, as many as the command had; zero beyond. The command itself when nothing was
   corrected, with zero for what is not finite.
   */
  double joints[POEGP_MAX_JOINTS];
  /*
   How much of the arm's error is corrected, 0 to 1: 1 but beside singularities and where a bound acts.
   */
  double applied;
  /*
   Distance in metres that stays, by the model, between the arm at these joints and the nominal one at the command.
   */
  double position_error;
  /*
   The rotation error that stays, in radians.
   */
  double rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_corrected_f64_t;

/*
 The answer of `poegp_forward` and `poegp_forward_f64`.
 */
typedef struct poegp_forward_f64_t {
  /*
   Transform from the tool to the base, a 3x4 matrix [R | t] row by row; metres. R is orthonormal to 1e-6.
   */
  double base_from_tool[12];
  /*
   Extrapolation score: 1 within the trained ranges, falling to 0 outside.
   */
  double trust;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_forward_f64_t;

/*
 The answer of `poegp_inverse` and `poegp_inverse_f64`.
 */
typedef struct poegp_inverse_f64_t {
  /*
   Joints to command, rad or m, as many as the seed had; zero beyond. Always finite.
   */
  double joints[POEGP_MAX_JOINTS];
  /*
   Distance in metres between the wanted pose and that of the tool at these joints.
   */
  double position_error;
  /*
   The rotation between them, in radians.
   */
  double rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark. POEGP_STATUS_PARTLY_CORRECTED: the
   pose was not reached within 5 um and 5 urad.
   */
  uint32_t status;
} poegp_inverse_f64_t;

/*
 The answer of `poegp_jacobian` and `poegp_jacobian_f64`.
 */
typedef struct poegp_jacobian_f64_t {
  /*
   The Jacobian row by row; one column for each joint, zeros beyond. Rows 0 to 2 are the velocity of the tool's origin in
   m, rows 3 to 5 the angular velocity in rad, per rad or m of the joint. Both are along the x, y and z axes of the base.
   */
  double rows[6][POEGP_MAX_JOINTS];
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_jacobian_f64_t;

/*
 Limits and times of a filter. For sliding joints m stands for rad. `poegp_filter_defaults` fills it.
 */
typedef struct poegp_filter_settings_f64_t {
  /*
   Time between two commands in s, 50 us to 0.1 s.
   */
  double period_s;
  /*
   Largest rate of the correction beyond what the path explains, rad/s, 1e-4 to 1.
   */
  double rate;
  /*
   Largest acceleration of the correction beyond what the path explains, rad/s^2, 1e-3 to 100.
   */
  double acceleration;
  /*
   Shortest time in s in which the correction is switched on or off, or the payload changes; 0.01 to 10, and at least
   ten periods.
   */
  double blend_s;
} poegp_filter_settings_f64_t;

/*
 The answer of `poegp_command` and `poegp_command_f64`.
 */
typedef struct poegp_commanded_f64_t {
  /*
   Joints to send, rad or m, as many as the command had; zero beyond. Always finite.
   */
  double joints[POEGP_MAX_JOINTS];
  /*
   How far the correction is switched on, 0 to 1.
   */
  double weight;
  /*
   What `poegp_correct` says of the corrected command, to which the joints go while the correction is on: how much of
   the arm's error it takes away, 0 to 1.
   */
  double applied;
  /*
   The same: distance that stays, in metres.
   */
  double position_error;
  /*
   The same: rotation that stays, in radians.
   */
  double rotation_error;
  /*
   What it is worth: a sum of POEGP_STATUS_ bits, 0 when there is nothing to remark.
   */
  uint32_t status;
} poegp_commanded_f64_t;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Bytes of a model in this build of the library; at most POEGP_MODEL_BYTES.
 */
size_t poegp_model_size(void);

/*
 Alignment of a model in bytes; POEGP_MODEL_ALIGN.
 */
size_t poegp_model_align(void);

/*
 The POEGP_API_VERSION that the library was built with. When it is another than that of the header, do not go on.
 */
uint32_t poegp_api_version(void);

/*
 Makes an empty model in `bytes` bytes at `memory`, aligned to POEGP_MODEL_ALIGN, and stores its address in `*model`:
 null when it returns an error. The memory belongs to the model until it is no longer used; nothing has to be freed.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP.

 # Safety
 `memory` leads to `bytes` bytes that nobody else uses, `model` to a pointer.
 */
int32_t poegp_init(void *memory,
                   size_t bytes,
                   struct poegp_model_t **model);

/*
 Verifies a blob in every respect and takes over its model. All or nothing: after an error the last good model stays.
 The blob is copied and may go. Takes up to 20 kB of stack, and time that no cycle has: load into a second model
 while evaluations of the first go on.

 Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_MODEL_ codes.

 # Safety
 `model` comes from `poegp_init` and nobody else uses it during the call; `blob` leads to `length` bytes.
 */
int32_t poegp_load(struct poegp_model_t *model,
                   const uint8_t *blob,
                   size_t length);

/*
 As `poegp_load`, and refuses what is not signed by the Ed25519 key `public_key` of 32 bytes.
 Takes some kilobytes of stack more, and millions of instructions.

 Errors: as `poegp_load`, and POEGP_SIGNATURE_ codes.

 # Safety
 As `poegp_load`; `public_key` leads to 32 bytes.
 */
int32_t poegp_load_signed(struct poegp_model_t *model,
                          const uint8_t *blob,
                          size_t length,
                          const uint8_t *public_key);

/*
 Whether a blob is intact and signed by `public_key` of 32 bytes, without a model.

 Errors: POEGP_ERROR_ codes, POEGP_BLOB_ codes, POEGP_SIGNATURE_ codes.

 # Safety
 `blob` leads to `length` bytes, `public_key` to 32.
 */
int32_t poegp_verify(const uint8_t *blob, size_t length, const uint8_t *public_key);

/*
 Where the target really is, for `count` joints in rad or m and a payload in kg (0 when the model knows none). The
 time does not depend on the numbers. `joints` may lie in `*out`.

 Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. With an error code
 the answer is the identity and its status says POEGP_STATUS_NO_MODEL or POEGP_STATUS_BAD_INPUT, unless `out` itself
 cannot be used.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `joints` leads to `count` numbers; `out` is the
 caller's.
 */
int32_t poegp_evaluate(const struct poegp_model_t *model,
                       const float *joints,
                       size_t count,
                       float payload_kg,
                       struct poegp_evaluation_t *out);

/*
 The joints to command so that the real arm stands where the nominal one would at `joints` (rad or m), with a payload
 in kg. No joint changes by more than 0.1 rad or m. The answer is a continuous function of joints and payload, and
 nothing but a function of them: to switch it on, or to exchange the model, while the arm moves, see `poegp_command`.
 `joints` may lie in `*out`.

 Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. With an error code
 the answer is the command as it came, as far as it could be read, and its status says POEGP_STATUS_NO_MODEL or
 POEGP_STATUS_BAD_INPUT, unless `out` itself cannot be used.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 As `poegp_evaluate`.
 */
int32_t poegp_correct(const struct poegp_model_t *model,
                      const float *joints,
                      size_t count,
                      float payload_kg,
                      struct poegp_corrected_t *out);

/*
 Where the calibrated arm has a tool, for `count` joints in rad or m and a payload in kg (0 when the model knows none).
 `target_from_tool` is the tool's pose on the target that was measured: twelve numbers, a 3x4 matrix [R | t] row by row,
 metres. Null stands for the target itself. `joints` and `target_from_tool` may lie in `*out`.

 `poegp_evaluate` answers for the target alone, and also with the correction.

 Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. The answer is the identity
 beside an error code, without a model, and for joints or a tool that cannot be used (POEGP_STATUS_BAD_INPUT).

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `joints` leads to `count` numbers, `target_from_tool`
 to twelve if it is not null; `out` is the caller's.
 */
int32_t poegp_forward(const struct poegp_model_t *model,
                      const float *target_from_tool,
                      const float *joints,
                      size_t count,
                      float payload_kg,
                      struct poegp_forward_t *out);

/*
 The joints to command so that the calibrated arm has its tool at `base_from_tool`, with a payload in kg. It is the inverse
 of `poegp_forward`, on the branch of the `count` joints at `seed`: in a cycle, those sent last. Both poses are twelve
 numbers, a 3x4 matrix [R | t] row by row, metres; each R has to be orthonormal within 1e-3. `target_from_tool` as for
 `poegp_forward`. `seed` and both poses may lie in `*out`.

 The answer is never farther from the wanted pose than the seed. Where the pose is not reached, beyond the arm's reach or
 beside a singularity, the status has POEGP_STATUS_PARTLY_CORRECTED and the errors say by how much. Joint limits are not
 looked at. It takes some evaluations from a near seed, at most 61 from any.

 Roundings of `float` joints, at 1 kHz, are noise of 0.4 rad/s^2 in their accelerations. Use `poegp_inverse_f64` where joints
 are sent as `double`.

 Returns POEGP_OK for every number that C can hold. Beside an error code, without a model, and for bad input
 (POEGP_STATUS_BAD_INPUT) the answer is the seed as far as it could be read, with zero for what is not finite.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 As `poegp_forward`; `base_from_tool` leads to twelve numbers, `seed` to `count`.
 */
int32_t poegp_inverse(const struct poegp_model_t *model,
                      const float *target_from_tool,
                      const float *base_from_tool,
                      const float *seed,
                      size_t count,
                      float payload_kg,
                      struct poegp_inverse_t *out);

/*
 The Jacobian of the calibrated arm: how the tool moves with each of the `count` joints (rad or m), with a payload in kg.
 Arguments as for `poegp_forward`.

 The reference point is the tool's origin and the axes are those of the base: rows of linear, then of angular velocity, as
 Pinocchio's LOCAL_WORLD_ALIGNED. Columns are the controller's joints, a coupling of the joints included.

 The Jacobian is that of the calibrated chain at the controller's joints, with the reference point where the whole model has
 the tool. The derivative of the correction is left out. Numerical differences of `poegp_forward_f64` therefore differ: on an
 elastic model of an arm of 2 m by 0.001 m or rad per rad (root mean square), 0.0024 at most.

 Returns POEGP_OK for every number that C can hold. Beside an error code, without a model, and for bad input
 (POEGP_STATUS_BAD_INPUT) all columns are zero.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 As `poegp_forward`.
 */
int32_t poegp_jacobian(const struct poegp_model_t *model,
                       const float *target_from_tool,
                       const float *joints,
                       size_t count,
                       float payload_kg,
                       struct poegp_jacobian_t *out);

/*
 Which arm the model is of. Without a model the names are empty and the numbers zero.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `out` is the caller's.
 */
int32_t poegp_identify(const struct poegp_model_t *model, struct poegp_identity_t *out);

/*
 A code in words, as text that ends with a zero and need not be freed. Never null.
 */
const char *poegp_error_text(int32_t code);

/*
 The cause of a warning in words, by its bit in `poegp_identity_t.warnings`, as text that ends with a zero and need not be
 freed. Never null.
 */
const char *poegp_warning_text(uint32_t bit);

/*
 Bytes of a filter in this build of the library; at most POEGP_FILTER_BYTES.
 */
size_t poegp_filter_size(void);

/*
 Alignment of a filter in bytes; POEGP_FILTER_ALIGN.
 */
size_t poegp_filter_align(void);

/*
 The usual settings for this time between two commands in s: 20 mrad/s, 0.5 rad/s^2, 0.5 s.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED.

 # Safety
 `settings` is the caller's.
 */
int32_t poegp_filter_defaults(float period_s, struct poegp_filter_settings_t *settings);

/*
 Makes a filter in `bytes` bytes at `memory`, aligned to POEGP_FILTER_ALIGN, and stores its address in `*filter`: null
 when it returns an error. The memory belongs to the filter until it is no longer used; nothing has to be freed. For
 other settings make it again, while it is disengaged.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_TOO_SMALL, POEGP_ERROR_OVERLAP, POEGP_FILTER_ codes.

 # Safety
 `memory` leads to `bytes` bytes that nobody else uses, `settings` to settings, `filter` to a pointer.
 */
int32_t poegp_filter_init(void *memory,
                          size_t bytes,
                          const struct poegp_filter_settings_t *settings,
                          struct poegp_filter_t **filter);

/*
 The joints to send for a command of `count` joints (rad or m) and a payload in kg, once in every cycle. As
 `poegp_correct`, but what is sent does not step when the correction is switched on or off, the payload changes, a command
 is lost or the model is another: all that the motion of the command does not explain goes within the limits of the
 filter. The time does not depend on the numbers of a good command. `joints` may lie in `*out`. Another `count` than
 before resets the filter, unless the model refuses it.

 `engage`: 0 for the command itself (POEGP_STATUS_BYPASSED), else for the corrected one. On the way from one to the other
 the status has POEGP_STATUS_BLENDING. Arrived, the joints are those of `poegp_correct` to the bit, or the command to the
 bit, whatever model and payload are.
 `cycles`: how many have passed since the last call, 1 if none was left out; 0 for another answer to the same request.

 Returns POEGP_OK for every number that C can hold: what the answer is worth is in `out->status`. Bad input is answered
 with the joints that were sent last. Beside an error code the answer is, by the argument that is wrong:
 - `joints`: the joints that were sent last, POEGP_STATUS_BAD_INPUT;
 - `model`: joints whose correction goes to zero within the limits, POEGP_STATUS_NO_MODEL;
 - `filter`: the command as it came, POEGP_STATUS_BAD_INPUT;
 - `out`: none, and the filter is as if it had not been called.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `model` comes from `poegp_init` and is not loaded during the call; `filter` comes from `poegp_filter_init` and nobody
 else uses it during the call; `joints` leads to `count` numbers; `out` is the caller's.
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
 1 when nothing is applied and nothing moves: only now exchange the model, or make the filter again. Otherwise 0, also for
 what is no filter.

 # Safety
 `filter` comes from `poegp_filter_init` and nobody changes it during the call.
 */
int32_t poegp_filter_disengaged(const struct poegp_filter_t *filter);

/*
 What the filter has counted; zeros beside an error.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED, POEGP_ERROR_OVERLAP.

 # Safety
 `filter` comes from `poegp_filter_init` and nobody changes it during the call; `out` is the caller's.
 */
int32_t poegp_filter_counts(const struct poegp_filter_t *filter, struct poegp_filter_counts_t *out);

/*
 Forgets commands, correction and payload; settings and counts stay. The correction steps to zero unless the filter is
 disengaged: for an arm that stands still, its brakes on.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_NOT_INITIALISED.

 # Safety
 `filter` comes from `poegp_filter_init` and nobody else uses it during the call.
 */
int32_t poegp_filter_reset(struct poegp_filter_t *filter);

/*
 Writes the cyclic frame of a command for a device: `count` joints (rad or m) and a payload in kg, under a `sequence`
 number that is another one in every cycle. What goes on the line is the first `*length` bytes at `frame`, the last of them
 a zero; 37 for six joints. Nothing is computed and nothing is checked: what is not finite is answered by the device.

 Errors, with `*length` zero where it can be written: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_JOINTS,
 POEGP_ERROR_OVERLAP.

 # Safety
 `joints` leads to `count` numbers, `frame` to POEGP_CYCLIC_BYTES bytes of the caller, `length` to a number of the caller.
 */
int32_t poegp_cyclic_command(uint16_t sequence,
                             const float *joints,
                             size_t count,
                             float payload_kg,
                             uint8_t *frame,
                             size_t *length);

/*
 Reads the device's answer: the `length` bytes that came from the line up to a zero, with or without it. Beside an error
 nothing is written to `*out`: go on with the joints that were sent last.

 Errors: POEGP_ERROR_NULL, POEGP_ERROR_MISALIGNED, POEGP_ERROR_LENGTH, POEGP_ERROR_FRAME.

 # Safety
 `frame` leads to `length` bytes, `out` is the caller's.
 */
int32_t poegp_cyclic_answer(const uint8_t *frame,
                            size_t length,
                            struct poegp_cyclic_answer_t *out);

/*
 As `poegp_model_size`, in double precision; at most POEGP_MODEL_F64_BYTES.
 */
size_t poegp_model_size_f64(void);

/*
 As `poegp_filter_size`, in double precision; at most POEGP_FILTER_F64_BYTES.
 */
size_t poegp_filter_size_f64(void);

/*
 As `poegp_init`, for a model in double precision, with POEGP_MODEL_F64_BYTES of memory.

 # Safety
 As `poegp_init`.
 */
int32_t poegp_init_f64(void *memory, size_t bytes, struct poegp_model_f64_t **model);

/*
 As `poegp_load`, in double precision. The blob is the same one.

 # Safety
 As `poegp_load`.
 */
int32_t poegp_load_f64(struct poegp_model_f64_t *model, const uint8_t *blob, size_t length);

/*
 As `poegp_load_signed`, in double precision. The blob is the same one.

 # Safety
 As `poegp_load_signed`.
 */
int32_t poegp_load_signed_f64(struct poegp_model_f64_t *model,
                              const uint8_t *blob,
                              size_t length,
                              const uint8_t *public_key);

/*
 As `poegp_identify`, of a model in double precision.

 # Safety
 As `poegp_identify`.
 */
int32_t poegp_identify_f64(const struct poegp_model_f64_t *model, struct poegp_identity_t *out);

/*
 As `poegp_evaluate`, in double precision.

 # Safety
 As `poegp_evaluate`.
 */
int32_t poegp_evaluate_f64(const struct poegp_model_f64_t *model,
                           const double *joints,
                           size_t count,
                           double payload_kg,
                           struct poegp_evaluation_f64_t *out);

/*
 As `poegp_correct`, in double precision.

 # Safety
 As `poegp_correct`.
 */
int32_t poegp_correct_f64(const struct poegp_model_f64_t *model,
                          const double *joints,
                          size_t count,
                          double payload_kg,
                          struct poegp_corrected_f64_t *out);

/*
 As `poegp_forward`, in double precision.

 # Safety
 As `poegp_forward`.
 */
int32_t poegp_forward_f64(const struct poegp_model_f64_t *model,
                          const double *target_from_tool,
                          const double *joints,
                          size_t count,
                          double payload_kg,
                          struct poegp_forward_f64_t *out);

/*
 As `poegp_inverse`, in double precision: the pose is reached to 1e-12 m and rad, and at 1 kHz rounding adds less than
 0.0001 rad/s^2 to the accelerations of a smooth path.

 # Safety
 As `poegp_inverse`.
 */
int32_t poegp_inverse_f64(const struct poegp_model_f64_t *model,
                          const double *target_from_tool,
                          const double *base_from_tool,
                          const double *seed,
                          size_t count,
                          double payload_kg,
                          struct poegp_inverse_f64_t *out);

/*
 As `poegp_jacobian`, in double precision.

 # Safety
 As `poegp_jacobian`.
 */
int32_t poegp_jacobian_f64(const struct poegp_model_f64_t *model,
                           const double *target_from_tool,
                           const double *joints,
                           size_t count,
                           double payload_kg,
                           struct poegp_jacobian_f64_t *out);

/*
 As `poegp_filter_defaults`, in double precision.

 # Safety
 As `poegp_filter_defaults`.
 */
int32_t poegp_filter_defaults_f64(double period_s, struct poegp_filter_settings_f64_t *settings);

/*
 As `poegp_filter_init`, for a filter in double precision, with POEGP_FILTER_F64_BYTES of memory.

 # Safety
 As `poegp_filter_init`.
 */
int32_t poegp_filter_init_f64(void *memory,
                              size_t bytes,
                              const struct poegp_filter_settings_f64_t *settings,
                              struct poegp_filter_f64_t **filter);

/*
 As `poegp_command`, in double precision.

 # Safety
 As `poegp_command`.
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
 As `poegp_filter_disengaged`, of a filter in double precision.

 # Safety
 As `poegp_filter_disengaged`.
 */
int32_t poegp_filter_disengaged_f64(const struct poegp_filter_f64_t *filter);

/*
 As `poegp_filter_counts`, of a filter in double precision.

 # Safety
 As `poegp_filter_counts`.
 */
int32_t poegp_filter_counts_f64(const struct poegp_filter_f64_t *filter, struct poegp_filter_counts_t *out);

/*
 As `poegp_filter_reset`, of a filter in double precision.

 # Safety
 As `poegp_filter_reset`.
 */
int32_t poegp_filter_reset_f64(struct poegp_filter_f64_t *filter);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* POEGP_H */
