/* Kinematics of a calibrated robot arm for LinuxCNC.
 *
 * Copyright (C) 2026 the poegp authors
 * SPDX-License-Identifier: GPL-2.0-or-later
 *
 * This program is free software; you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation; either version 2 of the License, or (at your option) any later
 * version. It comes without any warranty; see the GNU General Public License for details.
 *
 * Only this folder is under that licence, because it includes headers of LinuxCNC. The library that it calls is not.
 *
 *     loadrt poegpkins blob=arm.blob tool=X,Y,Z,QW,QX,QY,QZ singular_deg=5
 *
 * X Y Z (mm) and A B C (deg; roll, pitch and yaw about the fixed axes x, y and z) are the tool in the base of the model.
 * README.md describes the pins. */

#include "rtapi.h"
#include "rtapi_app.h"
#include "rtapi_math.h"
#include "rtapi_string.h"
#include "hal.h"
#include "kinematics.h"

#include <stdio.h>
#include <stdlib.h>

#include "poegp.h"

MODULE_AUTHOR("poegp");
MODULE_DESCRIPTION("Kinematics of a calibrated robot arm");
MODULE_LICENSE("GPL");

static char *blob = "";
RTAPI_MP_STRING(blob, "file with the model");
static char *tool = "0,0,0,1,0,0,0";
RTAPI_MP_STRING(tool, "target_from_tool: x,y,z in mm and the quaternion w,x,y,z");
static char *singular_deg = "5";
RTAPI_MP_STRING(singular_deg, "distance from a singularity, by the turn of one joint, at which the arm stops");

#define JOINTS 6
#define BLOB_BYTES 65536
#define DEG (M_PI / 180)
/* No joint turns as far in one cycle, and no tool moves as far. LinuxCNC also asks for the ends of lines. */
#define CYCLE_RAD 0.05
#define CYCLE_MM 5
#define CYCLE_DEG 3
/* What the inverse leaves of a joint that stands still, with room. */
#define STILL_RAD 1e-9
/* Cycles without a pose after which the arm may stand anywhere else. */
#define PAUSE_CYCLES 5
/* A new payload bends the arm differently: it comes in slowly, kg for each cycle. */
#define PAYLOAD_STEP_KG 0.001
/* The model takes no more. */
#define MOST_PAYLOAD_KG 100000

typedef struct {
    hal_float_t *payload_kg;      /* in */
    hal_float_t *position_error;  /* out: m */
    hal_float_t *trust;           /* out: 1 within the trained ranges, falling to 0 outside */
    hal_u32_t *status;            /* out: POEGP_STATUS_ bits */
    hal_u32_t *inverse_ns;        /* out: time of the last inverse */
    hal_u32_t *singular_joint;    /* out: from 1; 0 away from singularities */
} pins_t;

static int component;
static pins_t *pins;
static _Alignas(POEGP_MODEL_ALIGN) unsigned char memory[POEGP_MODEL_F64_BYTES];
static poegp_model_f64_t *model;
static double target_from_tool[12];
static double margin;

static double payload_kg;
/* The pose of the cycle before. */
static EmcPose followed;
static int cycles_without_pose = PAUSE_CYCLES + 1;
/* The sign of the Jacobian's determinant here, and which probes have the other one. */
static int hand;
static int crossed[2 * JOINTS];
static int probe;
static double probed_at[JOINTS];
static int complained;

/* ---- poses ---- */

static void pose_from(const EmcPose *world, double m[12])
{
    double cr = cos(world->a * DEG), sr = sin(world->a * DEG);
    double cp = cos(world->b * DEG), sp = sin(world->b * DEG);
    double cy = cos(world->c * DEG), sy = sin(world->c * DEG);
    double rows[12] = {
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, world->tran.x / 1000,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, world->tran.y / 1000,
        -sp,     cp * sr,                cp * cr,                world->tran.z / 1000,
    };
    memcpy(m, rows, sizeof rows);
}

static void pose_to(const double m[12], EmcPose *world)
{
    world->tran.x = m[3] * 1000;
    world->tran.y = m[7] * 1000;
    world->tran.z = m[11] * 1000;
    world->a = atan2(m[9], m[10]) / DEG;
    world->b = atan2(-m[8], sqrt(m[0] * m[0] + m[4] * m[4])) / DEG;
    world->c = atan2(m[4], m[0]) / DEG;
}

/* ---- singularities ---- */

/* Sign of the determinant of the Jacobian: another one beyond a singularity. 0 where there is none. */
static int side(const double joints[JOINTS])
{
    static poegp_jacobian_f64_t jacobian;
    double a[JOINTS][JOINTS];
    int sign = 1, row, column, k;

    if (poegp_jacobian_f64(model, target_from_tool, joints, JOINTS, payload_kg, &jacobian) != POEGP_OK) {
        return 0;
    }
    for (row = 0; row < JOINTS; row++) {
        for (column = 0; column < JOINTS; column++) {
            a[row][column] = jacobian.rows[row][column];
        }
    }
    for (k = 0; k < JOINTS; k++) {
        int pivot = k;
        for (row = k + 1; row < JOINTS; row++) {
            if (fabs(a[row][k]) > fabs(a[pivot][k])) {
                pivot = row;
            }
        }
        if (a[pivot][k] == 0) {
            return 0;
        }
        for (column = k; pivot != k && column < JOINTS; column++) {
            double swapped = a[k][column];
            a[k][column] = a[pivot][column];
            a[pivot][column] = swapped;
        }
        sign *= (pivot != k) != (a[k][k] < 0) ? -1 : 1;
        for (row = k + 1; row < JOINTS; row++) {
            double share = a[row][k] / a[k][k];
            for (column = k; column < JOINTS; column++) {
                a[row][column] -= share * a[k][column];
            }
        }
    }
    return sign;
}

/* Turns one joint by the margin, the next one in the next call: whether that would pass a singularity. */
static void look(const double joints[JOINTS])
{
    double turned[JOINTS];
    memcpy(probed_at, joints, sizeof probed_at);
    memcpy(turned, joints, sizeof turned);
    turned[probe / 2] += probe % 2 ? margin : -margin;
    crossed[probe] = side(turned) != hand;
    probe = (probe + 1) % (2 * JOINTS);
}

/* The joint that stands near a singularity, from 1; 0 if none does. */
static unsigned singular(void)
{
    int i;
    for (i = 0; i < 2 * JOINTS; i++) {
        if (crossed[i]) {
            return i / 2 + 1;
        }
    }
    return 0;
}

/* Whether a joint turns towards a singularity that it stands beside. Standing still and turning away are allowed: LinuxCNC
   asks for the pose at which the arm stands when it is switched on again, and sends zeros where that is refused. */
static int approaches(const double from[JOINTS], const double to[JOINTS])
{
    int i;
    for (i = 0; i < 2 * JOINTS; i++) {
        double turn = to[i / 2] - from[i / 2];
        if (crossed[i] && (i % 2 ? turn : -turn) > STILL_RAD) {
            return 1;
        }
    }
    return 0;
}

/* Looks again after every 1/120 of the margin that a joint has turned: in all directions after 1/10 of it. Costs the time of a
   Jacobian, in few cycles of a slow path and in every cycle of a fast one. */
static void keep_looking(const double joints[JOINTS])
{
    int i;
    for (i = 0; i < JOINTS; i++) {
        if (fabs(joints[i] - probed_at[i]) > margin / 120) {
            look(joints);
            return;
        }
    }
}

/* The payload that the pin asks for. A load cell's zero may read below 0, and a sample that is no number does not count. */
static double asked_kg(void)
{
    static double last;
    double pin = *pins->payload_kg;
    if (pin == pin) {
        last = pin < 0 ? 0 : pin > MOST_PAYLOAD_KG ? MOST_PAYLOAD_KG : pin;
    }
    return last;
}

/* The arm may stand anywhere: all that is known of singularities is found again. */
static void look_around(const double joints[JOINTS])
{
    int i;
    payload_kg = asked_kg();
    hand = side(joints);
    for (i = 0; i < 2 * JOINTS; i++) {
        look(joints);
    }
}

/* Whether a pose continues the path, rather than being the end of a line. */
static int continues(const EmcPose *world)
{
    return fabs(world->tran.x - followed.tran.x) < CYCLE_MM && fabs(world->tran.y - followed.tran.y) < CYCLE_MM
        && fabs(world->tran.z - followed.tran.z) < CYCLE_MM && fabs(world->a - followed.a) < CYCLE_DEG
        && fabs(world->b - followed.b) < CYCLE_DEG && fabs(world->c - followed.c) < CYCLE_DEG;
}

/* ---- what LinuxCNC calls ---- */

KINEMATICS_TYPE kinematicsType(void)
{
    return KINEMATICS_BOTH;
}

int kinematicsSwitchable(void)
{
    return 0;
}

int kinematicsSwitch(int type)
{
    (void)type;
    return 0;
}

int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags)
{
    double joints[JOINTS];
    poegp_forward_f64_t found;
    int i;
    (void)fflags;
    (void)iflags;

    if (cycles_without_pose <= PAUSE_CYCLES) {
        cycles_without_pose++;
    } else {
        payload_kg = asked_kg();
    }
    for (i = 0; i < JOINTS; i++) {
        joints[i] = joint[i] * DEG;
    }
    if (poegp_forward_f64(model, target_from_tool, joints, JOINTS, payload_kg, &found) != POEGP_OK
        || (found.status & (POEGP_STATUS_NO_MODEL | POEGP_STATUS_BAD_INPUT)) != 0) {
        return -1;
    }
    *pins->trust = found.trust;
    pose_to(found.base_from_tool, world);
    return 0;
}

int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags)
{
    const uint32_t stop = POEGP_STATUS_NO_MODEL | POEGP_STATUS_BAD_INPUT | POEGP_STATUS_PARTLY_CORRECTED;
    long long int began = rtapi_get_time();
    double base_from_tool[12], joints[JOINTS];
    poegp_inverse_f64_t found;
    int i, is_cycle, is_singular, jumps, farthest = 0;
    (void)iflags;
    (void)fflags;

    for (i = 0; i < JOINTS; i++) {
        joints[i] = joint[i] * DEG;
    }
    if (cycles_without_pose > PAUSE_CYCLES) {
        look_around(joints);
    } else {
        double left = asked_kg() - payload_kg;
        payload_kg += left > PAYLOAD_STEP_KG ? PAYLOAD_STEP_KG : left < -PAYLOAD_STEP_KG ? -PAYLOAD_STEP_KG : left;
    }
    pose_from(world, base_from_tool);
    if (poegp_inverse_f64(model, target_from_tool, base_from_tool, joints, JOINTS, payload_kg, &found) != POEGP_OK) {
        return -1;
    }
    for (i = 1; i < JOINTS; i++) {
        if (fabs(found.joints[i] - joints[i]) > fabs(found.joints[farthest] - joints[farthest])) {
            farthest = i;
        }
    }
    jumps = fabs(found.joints[farthest] - joints[farthest]) > CYCLE_RAD;
    is_cycle = cycles_without_pose > PAUSE_CYCLES ? !jumps : continues(world);
    if (is_cycle) {
        cycles_without_pose = 0;
        followed = *world;
        keep_looking(found.joints);
        *pins->singular_joint = singular();
    }
    *pins->status = found.status;
    *pins->position_error = found.position_error;
    *pins->inverse_ns = rtapi_get_time() - began;

    is_singular = is_cycle && approaches(joints, found.joints);
    if (is_singular || (is_cycle && jumps) || (found.status & stop) != 0) {
        if (!complained && is_singular) {
            rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: joint %u is within %s degrees of a singularity: the arm stops on its path. "
                            "Switch the machine on and turn the joint away\n", *pins->singular_joint, singular_deg);
        } else if (!complained && is_cycle && jumps) {
            rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: joint %d would turn by %.2f degrees in one cycle: the arm stops on its path\n",
                            farthest + 1, (found.joints[farthest] - joints[farthest]) / DEG);
        } else if (!complained && (found.status & POEGP_STATUS_BAD_INPUT) != 0) {
            rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: a joint or the pose is not a number that a model takes\n");
        } else if (!complained) {
            rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: the arm does not reach X %.3f Y %.3f Z %.3f A %.3f B %.3f C %.3f: %.3f mm "
                            "are left\n", world->tran.x, world->tran.y, world->tran.z, world->a, world->b, world->c,
                            found.position_error * 1000);
        }
        complained = 1;
        return -1;
    }
    complained = 0;
    for (i = 0; i < JOINTS; i++) {
        joint[i] = found.joints[i] / DEG;
    }
    return 0;
}

EXPORT_SYMBOL(kinematicsSwitchable);
EXPORT_SYMBOL(kinematicsSwitch);
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);

/* ---- loading ---- */

static int load_blob(void)
{
    static unsigned char bytes[BLOB_BYTES];
    poegp_identity_t identity;
    FILE *file = fopen(blob, "rb");
    size_t length;
    int32_t code;

    if (file == NULL) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: blob=%s: no such file, or it cannot be read\n", blob);
        return -ENOENT;
    }
    length = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    if (poegp_api_version() != POEGP_API_VERSION) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: libpoegp_capi.a has version %u of the interface, poegp.h %u\n",
                        poegp_api_version(), POEGP_API_VERSION);
        return -EINVAL;
    }
    code = poegp_init_f64(memory, sizeof memory, &model);
    if (code == POEGP_OK) {
        code = poegp_load_f64(model, bytes, length);
    }
    if (code == POEGP_OK) {
        code = poegp_identify_f64(model, &identity);
    }
    if (code != POEGP_OK) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: blob=%s: %s\n", blob, poegp_error_text(code));
        return -EINVAL;
    }
    if (identity.joints != JOINTS) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: blob=%s: the model has %u joints, expected %d\n", blob, identity.joints, JOINTS);
        return -EINVAL;
    }
    rtapi_print_msg(RTAPI_MSG_INFO, "poegpkins: %s, blob %08x\n", identity.robot, identity.blob_crc);
    return 0;
}

static int read_tool(void)
{
    double n[7], *m = target_from_tool, length;
    char rest;
    if (sscanf(tool, "%lf,%lf,%lf,%lf,%lf,%lf,%lf%c", n, n + 1, n + 2, n + 3, n + 4, n + 5, n + 6, &rest) != 7) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: tool=%s: expected seven numbers: x,y,z in mm and the quaternion w,x,y,z\n", tool);
        return -EINVAL;
    }
    length = sqrt(n[3] * n[3] + n[4] * n[4] + n[5] * n[5] + n[6] * n[6]);
    if (!(fabs(length - 1) < 1e-3)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: tool=%s: the quaternion has the length %g, expected 1\n", tool, length);
        return -EINVAL;
    }
    double w = n[3] / length, x = n[4] / length, y = n[5] / length, z = n[6] / length;
    double rows[12] = {
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), n[0] / 1000,
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), n[1] / 1000,
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), n[2] / 1000,
    };
    memcpy(m, rows, sizeof rows);
    return 0;
}

static int make_pins(void)
{
    int code;
    pins = hal_malloc(sizeof *pins);
    if (pins == NULL) {
        return -ENOMEM;
    }
    code = hal_pin_float_newf(HAL_IN, &pins->payload_kg, component, "poegpkins.payload-kg");
    code = code ? code : hal_pin_float_newf(HAL_OUT, &pins->position_error, component, "poegpkins.position-error");
    code = code ? code : hal_pin_float_newf(HAL_OUT, &pins->trust, component, "poegpkins.trust");
    code = code ? code : hal_pin_u32_newf(HAL_OUT, &pins->status, component, "poegpkins.status");
    code = code ? code : hal_pin_u32_newf(HAL_OUT, &pins->inverse_ns, component, "poegpkins.inverse-ns");
    return code ? code : hal_pin_u32_newf(HAL_OUT, &pins->singular_joint, component, "poegpkins.singular-joint");
}

int rtapi_app_main(void)
{
    char *end;
    int code;

    margin = strtod(singular_deg, &end) * DEG;
    if (*end != 0 || !(margin > 0 && margin < 45 * DEG)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "poegpkins: singular_deg=%s: expected a number of degrees, above 0 and below 45\n", singular_deg);
        return -EINVAL;
    }
    code = load_blob();
    code = code ? code : read_tool();
    if (code) {
        return code;
    }
    component = hal_init("poegpkins");
    if (component < 0) {
        return component;
    }
    code = make_pins();
    if (code) {
        hal_exit(component);
        return code;
    }
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(component);
}
