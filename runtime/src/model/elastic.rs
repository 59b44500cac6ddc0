//! Checks the elastic correction of a blob and loads it.

use heapless::Vec;
use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::blob::{Elastic, Joint, Variance};
use poegp_protocol::limits::{MAX_CURVE_ORDER, MAX_JOINTS};

use crate::elastic::deflection::Deflection;
use crate::elastic::gravity::{Gravity, GravityTerms};
use crate::elastic::ripple::RippleTerm;
use crate::gp::inducing_sets::InducingSet;
use crate::gp::joint_processes::JointProcesses;
use crate::guard::limit::Limit;
use crate::kinematics::minimal_chain::MinimalForm;
use crate::math::scalar::Scalar;
use crate::model::cost::ElasticSize;
use crate::model::load_error::LoadError;
use crate::model::validate::{
    MAX_COEFFICIENT, MAX_RATE_SUM, checked_limit, checked_rows, feature_limit, is_within,
};

/// Largest number of cycles per turn of a ripple term.
const MAX_CYCLES: f32 = 4_096.0;
/// Largest amplitude of one order of an own-joint curve in rad.
const MAX_CURVE_AMPLITUDE: f32 = 1.0;
/// Payloads are clamped to this many times the heaviest trained one.
const PAYLOAD_REACH: f32 = 8.0;
/// Largest payload exponent W_cm (m − m′)².
const MAX_PAYLOAD_EXPONENT: f32 = 1_000_000.0;

/// The elastic correction and its bound.
#[derive(Clone, Debug)]
pub(crate) struct ElasticCorrection<T> {
    pub(crate) deflection: Deflection<T>,
    pub(crate) limit: Limit<T>,
    /// Largest payload in kg, to which heavier ones are clamped.
    pub(crate) heaviest: T,
}

impl<T: Scalar> ElasticCorrection<T> {
    /// Returns a correction without effect.
    #[inline(always)]
    pub(super) fn empty() -> Self {
        Self {
            deflection: Deflection {
                gravity: Gravity::zero(),
                ripple: Vec::new(),
                curve_orders: 0,
                processes: JointProcesses::none(),
                variance: None,
            },
            limit: Limit {
                position: T::ZERO,
                angle: T::ZERO,
            },
            heaviest: T::ZERO,
        }
    }

    /// Fills an empty correction from a blob. In place: a returned correction would be on the stack once more. After an
    /// error the correction must not be used.
    #[inline(never)]
    pub(super) fn fill(
        &mut self,
        wire: &Elastic<'_>,
        variance: Option<&Variance<'_>>,
        calibrated: &MinimalForm<T>,
        joint_ranges: &[(T, T)],
        payload: Option<(f32, f32)>,
    ) -> Result<(), LoadError> {
        let joints = calibrated.poe.kinds().len();
        let heaviest =
            PAYLOAD_REACH * payload.map_or(0.0, |(_, heavy)| if heavy > 1.0 { heavy } else { 1.0 });
        let out = &mut self.deflection;
        processes(wire, joints, heaviest, &mut out.processes)?;
        let kinds = calibrated.poe.kinds();
        out.processes.choose_loops(kinds, joint_ranges);
        gravity(wire, calibrated, &mut out.gravity)?;
        out.ripple = ripple(wire, joints)?;
        out.curve_orders = wire.curves.len() / (8 * joints.max(1));
        let varying = variance.filter(|wire| !wire.rates.is_empty());
        out.variance = varying.map(super::position_variance::header);
        self.limit = checked_limit(&wire.limit)?;
        self.heaviest = T::from_f32(heaviest);
        Ok(())
    }
}

impl<T: Scalar> ElasticCorrection<T> {
    /// Returns the sizes of the correction, which determine its cost.
    #[inline(never)]
    pub(super) fn size(&self, kinds: &[JointKind]) -> ElasticSize {
        let terms = &self.deflection;
        let (loaded_joints, loaded_links) = terms.gravity.loads(kinds);
        let size = ElasticSize {
            loaded_joints,
            loaded_links,
            upright: terms.gravity.is_upright(),
            ripple: terms.ripple.len(),
            curve_orders: terms.curve_orders,
            landmarks: terms.variance.as_ref().map_or(0, |v| v.landmarks),
            ..ElasticSize::default()
        };
        size.with_processes(&terms.processes)
    }

    /// Clamps a payload in kg to [`ElasticCorrection::heaviest`].
    #[inline(always)]
    pub(crate) fn held(&self, payload_kg: T) -> T {
        if payload_kg > self.heaviest {
            self.heaviest
        } else {
            payload_kg
        }
    }
}

fn coefficient<T: Scalar>(value: f32) -> Result<T, LoadError> {
    if is_within(value, -MAX_COEFFICIENT, MAX_COEFFICIENT) {
        Ok(T::from_f32(value))
    } else {
        Err(LoadError::Kernel)
    }
}

fn vector<T: Scalar>(values: &[f32; 3]) -> Result<Vector3<T>, LoadError> {
    Ok(Vector3::new(
        coefficient(values[0])?,
        coefficient(values[1])?,
        coefficient(values[2])?,
    ))
}

// A separate function: the coefficients in their stored form are on the stack only while it runs.
#[inline(never)]
fn gravity<T: Scalar>(
    wire: &Elastic<'_>,
    form: &MinimalForm<T>,
    found: &mut Gravity<T>,
) -> Result<(), LoadError> {
    let joints = form.poe.kinds().len();
    let mut out = GravityTerms::zero();
    out.gravity = vector(&wire.gravity)?;
    if !wire.links.is_empty() {
        if wire.links.len() != joints * (joints + 1) / 2 {
            return Err(LoadError::Gravity);
        }
        let mut values = wire.links.iter();
        for (joint, row) in out.links.iter_mut().enumerate().take(joints) {
            for slot in row.iter_mut().take(joints).skip(joint) {
                *slot = vector(values.next().ok_or(LoadError::Gravity)?)?;
            }
        }
    }
    if !wire.payload.is_empty() {
        if wire.payload.len() != joints {
            return Err(LoadError::Gravity);
        }
        let slots = out.payload_lever.iter_mut().zip(&mut out.payload_offset);
        for ((lever, offset), [a, b, c, d]) in slots.zip(&wire.payload) {
            *lever = coefficient(*a)?;
            *offset = vector(&[*b, *c, *d])?;
        }
    }
    out.turn_into(form);
    found.set(&out, form);
    Ok(())
}

fn ripple<T: Scalar, const N: usize>(
    wire: &Elastic<'_>,
    joints: usize,
) -> Result<Vec<RippleTerm<T>, N>, LoadError> {
    let mut out = Vec::new();
    for term in &wire.ripple {
        let joint = usize::from(term.joint);
        if joint >= joints || !is_within(term.cycles, 0.0, MAX_CYCLES) {
            return Err(LoadError::Ripple);
        }
        let term = RippleTerm {
            joint,
            cycles: T::from_f32(term.cycles),
            sin: coefficient(term.sin)?,
            cos: coefficient(term.cos)?,
        };
        out.push(term).map_err(|_| LoadError::Ripple)?;
    }
    Ok(out)
}

/// Returns the bytes of the own-joint curves after checking every coefficient.
pub(super) fn checked_curves<'a>(
    wire: &Elastic<'a>,
    joints: usize,
    capacity: usize,
) -> Result<&'a [u8], LoadError> {
    // Bytes of one order: all joints have the same number of orders.
    let order = 8 * joints.clamp(1, MAX_JOINTS);
    if !wire.curves.len().is_multiple_of(order) || wire.curves.len() / order > MAX_CURVE_ORDER {
        return Err(LoadError::Curve);
    }
    let limit = |_| MAX_CURVE_AMPLITUDE;
    checked_rows(wire.curves, 1, limit, capacity).map_err(|error| match error {
        LoadError::Row => LoadError::Curve,
        other => other,
    })
}

fn processes<T: Scalar>(
    wire: &Elastic<'_>,
    joints: usize,
    heaviest: f32,
    out: &mut JointProcesses<T>,
) -> Result<(), LoadError> {
    for payload_kg in &wire.group_payloads_kg {
        if !is_within(*payload_kg, 0.0, heaviest) {
            return Err(LoadError::Groups);
        }
        let payload_kg = T::from_f32(*payload_kg);
        let room = out.group_payloads_kg.push(payload_kg);
        room.map_err(|_| LoadError::Groups)?;
    }
    if wire.kernels.is_empty() && wire.sets.is_empty() && wire.rows.is_empty() {
        return Ok(());
    }
    if wire.kernels.len() != joints {
        return Err(LoadError::Kernel);
    }
    for (slot, kernel) in out.kernels.iter_mut().zip(&wire.kernels) {
        let mut sum = 0.0;
        for rate in &kernel.rates {
            sum += if is_within(*rate, 0.0, MAX_RATE_SUM) {
                *rate
            } else {
                f32::INFINITY
            };
        }
        let reach = kernel.payload_rate * heaviest * heaviest;
        if kernel.rates.len() != joints
            || !is_within(sum, 0.0, MAX_RATE_SUM)
            || !is_within(kernel.payload_rate, 0.0, MAX_COEFFICIENT)
            || !is_within(reach, 0.0, MAX_PAYLOAD_EXPONENT)
        {
            return Err(LoadError::Kernel);
        }
        slot.set_rates(kernel.rates.iter().map(|rate| T::from_f32(*rate)));
        slot.payload_rate = T::from_f32(kernel.payload_rate);
        slot.amplitude = coefficient(kernel.amplitude)?;
        slot.payload_amplitude = coefficient(kernel.payload_amplitude)?;
    }
    sets(wire, joints, out)
}

/// Adds the inducing sets, one for each joint, and checks that the blob has as many rows.
fn sets<T: Scalar>(
    wire: &Elastic<'_>,
    joints: usize,
    out: &mut JointProcesses<T>,
) -> Result<(), LoadError> {
    if wire.sets.len() != joints {
        return Err(LoadError::Groups);
    }
    for (points, kernel) in wire.sets.iter().zip(&out.kernels) {
        if points.len() != wire.group_payloads_kg.len() {
            return Err(LoadError::Groups);
        }
        let set = InducingSet::new(kernel, points);
        out.sets.push(set).map_err(|_| LoadError::Groups)?;
    }
    if 4 * out.words() != wire.rows.len() {
        return Err(LoadError::Groups);
    }
    Ok(())
}

/// Returns the bytes of the inducing points after checking every word.
pub(super) fn checked_points<'a>(
    wire: &Elastic<'a>,
    joints: &[Joint],
    capacity: usize,
) -> Result<&'a [u8], LoadError> {
    let words = wire.rows.len() / 4;
    if words > capacity {
        return Err(LoadError::InducingPointsTooLarge {
            needed: words as u32,
            capacity: capacity as u32,
        });
    }
    let mut rest = wire.rows;
    for (points, kernel) in wire.sets.iter().zip(&wire.kernels) {
        let mut active = [JointKind::Revolute; MAX_JOINTS];
        let mut slots = active.iter_mut();
        let mut count = 0;
        for (joint, rate) in joints.iter().zip(&kernel.rates) {
            if *rate > 0.0
                && let Some(slot) = slots.next()
            {
                *slot = joint.kind;
                count += 1;
            }
        }
        let limit = |index: usize| match active.get(index / 2) {
            Some(kind) if index / 2 < count => feature_limit(*kind),
            _ => MAX_COEFFICIENT,
        };
        let mut rows = 0;
        for group in points {
            rows += usize::from(*group);
        }
        let row_words = 2 * count + 1;
        // `sets` has checked the number of bytes.
        let (here, after) = rest
            .split_at_checked(4 * rows * row_words)
            .ok_or(LoadError::Groups)?;
        rest = after;
        checked_rows(here, row_words, limit, capacity)?;
    }
    Ok(wire.rows)
}
