//! Computes the correction that a controller adds to the axes of one cycle, with the device's model, filter and bound in
//! `f64`.

use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::filter::{CommandFilter, CorrectionBound, FilterError, FilterSettings, GRACE};
use poegp_runtime::guard::status::Status;

use crate::bridge::message::{MicroDegrees, Setpoint, micro_degrees};
use crate::bridge::{AXES, Axes};

/// A millionth of a degree, in degrees: answers are rounded to it.
const MICRO_DEGREE: f64 = 1e-6;

/// Settings that the user chooses.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Payload in kg.
    pub payload_kg: f64,
    /// Which axis values are corrected.
    pub setpoint: Setpoint,
    /// Largest correction of an axis, in degrees.
    pub limit_deg: f64,
    /// Largest change of the correction of an axis from one answer to the next, in degrees.
    pub ramp_deg: f64,
}

/// The correction of one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Correction of each axis in millionths of a degree.
    pub axes: MicroDegrees,
    /// Status of the model.
    pub status: Status,
    /// Whether the axes could not be used and this is the last correction again.
    pub held: bool,
    /// Whether the bound limits the size of the correction.
    pub limited: bool,
    /// Whether the bound limits the change of the correction.
    pub slowed: bool,
}

/// Corrects the axes of one controller.
#[derive(Debug)]
pub struct Corrector {
    commander: Commander,
    settings: Settings,
    filter: CommandFilter<f64>,
    bound: CorrectionBound<f64>,
    /// Whether the filter is configured.
    is_configured: bool,
    /// Cycles since the last one whose correction was computed.
    missed: u32,
}

impl Corrector {
    /// Creates a corrector whose correction is zero.
    pub fn new(commander: Commander, settings: Settings) -> Self {
        // With this margin, both ends of a change stay within the limits after rounding.
        let within = |degrees: f64| (degrees - MICRO_DEGREE).to_radians();
        Self {
            bound: CorrectionBound::new(within(settings.limit_deg), within(settings.ramp_deg)),
            filter: CommandFilter::new(),
            is_configured: false,
            missed: 0,
            commander,
            settings,
        }
    }

    /// Begins a session, in which the controller has no correction yet.
    pub fn reset(&mut self) {
        self.filter = CommandFilter::new();
        self.bound.reset();
        self.is_configured = false;
        self.missed = 0;
    }

    /// Sets the cycle time in ms. Nothing is corrected before that.
    ///
    /// # Errors
    /// [`FilterError`] for a cycle time that no controller has.
    pub fn configure(&mut self, cycle_ms: u64) -> Result<(), FilterError> {
        if self.is_configured {
            return Ok(());
        }
        let usual = FilterSettings::with_period(1e-3 * cycle_ms as f64);
        let ramp = self.settings.ramp_deg.to_radians() / usual.period_s;
        self.filter.configure(&FilterSettings {
            rate: usual.rate.min(ramp),
            ..usual
        })?;
        self.is_configured = true;
        Ok(())
    }

    /// Returns whether the applied correction is zero.
    pub fn is_at_zero(&self) -> bool {
        self.bound.at_zero()
    }

    /// Returns the correction of these axes (rad), `cycles` after the last one. `engage` says whether they are to be
    /// corrected. Axes that cannot be used, `None`, hold the last correction.
    pub fn correct(&mut self, axes: Option<&Axes>, cycles: u32, engage: bool) -> Correction {
        let cycles = self.missed.saturating_add(cycles);
        let Some(axes) = axes else {
            self.missed = cycles;
            return self.hold(Status::BAD_INPUT);
        };
        let mut joints: Joints = [0.0; MAX_JOINTS];
        joints[..AXES].copy_from_slice(axes);
        if self.settings.setpoint == Setpoint::Actual {
            for (q, applied) in joints.iter_mut().zip(self.bound.last()) {
                *q -= applied;
            }
        }
        let engage = engage && self.is_configured;
        let payload_kg = self.filter.payload(self.settings.payload_kg, cycles);
        let corrected = self.commander.correct(&joints, payload_kg);
        let command = &joints[..AXES];
        let status = corrected.status;
        // After a gap the filter stops where it is. A correction that is withdrawn, perhaps because packets are lost, goes on
        // to zero.
        let cycles = if engage { cycles } else { cycles.min(GRACE) };
        let sent = (self.filter).step(command, &corrected.joints, status, engage, cycles);
        if sent.status.contains(Status::BAD_INPUT) {
            // The filter has counted the cycles. It holds the arm where it was, but RSI adds to a setpoint that moves on:
            // hold the correction instead.
            self.missed = 0;
            return self.hold(sent.status.with(status));
        }
        self.missed = 0;
        let mut wanted = [0.0; AXES];
        for ((slot, sent), q) in wanted.iter_mut().zip(&sent.joints).zip(command) {
            *slot = sent - q;
        }
        let bounded = self.bound.next(&wanted);
        Correction {
            axes: self.applied(),
            status,
            held: false,
            limited: bounded.limited,
            slowed: bounded.slowed,
        }
    }

    fn hold(&self, status: Status) -> Correction {
        Correction {
            axes: self.applied(),
            status,
            held: true,
            limited: false,
            slowed: false,
        }
    }

    /// Returns the last correction as it is written.
    fn applied(&self) -> MicroDegrees {
        let mut axes = [0.0; AXES];
        axes.copy_from_slice(&self.bound.last()[..AXES]);
        micro_degrees(&axes)
    }
}
