//! What `trainer calibrate` tells about an elastic model: noise, gear ripple, outliers.

use serde::Serialize;

use super::report::Report;
use crate::calibration::Calibration;
use crate::elastic::outliers::{OutlierPolicy, Reason};

/// The part of `--json`.
#[derive(Serialize)]
pub struct ElasticFacts {
    noise_mm: f64,
    noise_mrad: f64,
    support: usize,
    ripple: Vec<RippleFacts>,
    outliers: Vec<OutlierFacts>,
}

#[derive(Serialize)]
struct RippleFacts {
    joint: usize,
    cycles_per_turn: f64,
    amplitude_urad: f64,
}

#[derive(Serialize)]
struct OutlierFacts {
    line: usize,
    reason: &'static str,
    chi_squared: f64,
    rejected: bool,
}

impl ElasticFacts {
    /// Of a calibration; `lines` are the lines of the samples in their file.
    pub fn new(calibration: &Calibration, lines: &[usize]) -> Option<Self> {
        let report = &calibration.elastic.as_ref()?.report;
        let rejected = calibration.options.elastic.outliers == OutlierPolicy::Reject;
        let ripple = report
            .ripple
            .iter()
            .map(|(joint, cycles, amplitude)| RippleFacts {
                joint: *joint,
                cycles_per_turn: *cycles,
                amplitude_urad: 1e6 * amplitude,
            });
        let outliers = calibration.outliers.iter().map(|o| OutlierFacts {
            line: lines.get(o.sample).copied().unwrap_or(0),
            reason: match o.reason {
                Reason::Gross => "far from the calibrated arm",
                Reason::LeftOut => "far from what all other measurements predict",
            },
            chi_squared: o.chi_squared,
            rejected,
        });
        Some(Self {
            noise_mm: 1e3 * report.position_noise,
            noise_mrad: 1e3 * report.orientation_noise,
            support: report.support,
            ripple: ripple.collect(),
            outliers: outliers.collect(),
        })
    }

    /// The same for a reader.
    pub fn print(&self, report: Report) {
        report.line(format_args!(
            "  fitted noise of one component: {:.4} mm, {:.4} mrad",
            self.noise_mm, self.noise_mrad
        ));
        for r in &self.ripple {
            report.line(format_args!(
                "  gear ripple of joint {}: {:.1} cycles per turn, {:.0} µrad",
                r.joint, r.cycles_per_turn, r.amplitude_urad
            ));
        }
        for o in &self.outliers {
            report.line(format_args!(
                "  outlier in line {}: {} (χ² {:.0}); {}",
                o.line,
                o.reason,
                o.chi_squared,
                if o.rejected {
                    "left out"
                } else {
                    "kept; --outliers reject leaves it out"
                }
            ));
        }
    }
}
