//! What `trainer calibrate` reports about an elastic model: noise, gear ripple and the own-joint curve.

use serde::Serialize;

use crate::cli::terminal::print::Printer;
use crate::report::sections::Ripple;
use poegp_calibration::learning::elastic::warm_up::WarmUpReport;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::{Calibration, Method};
use poegp_calibration::numeric::lbfgs::SearchEnd;

/// The elastic model in the `--json` document.
#[derive(Serialize)]
pub struct ElasticSummary {
    noise_mm: f64,
    /// Orientation noise, mrad; `None` if no orientation was measured.
    noise_mrad: Option<f64>,
    inducing_points: usize,
    search: SearchSummary,
    pub ripple: Vec<Ripple>,
    /// Gear ripple that the model leaves out because the measured joint values do not determine its frequency.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    ambiguous_ripple: Vec<AmbiguousSummary>,
    /// Own-joint curve; `None` if the evidence does not support one.
    own_joint_curve: Option<CurveSummary>,
    /// Warm-up; `None` if the evidence shows none, or if the times of the rows are unknown.
    pub warm_up: Option<WarmUpReport>,
    /// RMS displacement of the target, in µm, by the smaller weights that single precision requires; left out if single
    /// precision holds the weights as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    single_precision_cost_um: Option<f64>,
    /// Predictive standard deviation of the position; present if the blob contains one.
    #[serde(skip_serializing_if = "Option::is_none")]
    predictive_std: Option<StdSummary>,
    /// Whether the configuration asks for a predictive standard deviation.
    #[serde(skip)]
    predictive_std_wanted: bool,
}

#[derive(Serialize)]
struct StdSummary {
    landmarks: usize,
    floor_mm: f64,
    noise_mm: f64,
}

/// How the hyperparameters were found.
#[derive(Serialize)]
struct SearchSummary {
    end: &'static str,
    iterations: u64,
    poses: usize,
    evidence_rise_nats: f64,
}

#[derive(Serialize)]
struct CurveSummary {
    amplitude_urad: f64,
    length_scale_deg: f64,
    orders: usize,
}

/// Frequencies that the measured joint values cannot distinguish.
#[derive(Serialize)]
struct AmbiguousSummary {
    joint: usize,
    cycles_per_turn: [f64; 2],
}

impl ElasticSummary {
    /// Summarises a calibration with its samples; `None` unless the correction is elastic.
    pub fn new(calibration: &Calibration, samples: &[InstrumentSample]) -> Option<Self> {
        let elastic = calibration.correction.elastic()?;
        let report = &elastic.report;
        let config = &calibration.config;
        let sigma = elastic.sigma.as_ref().map(|sigma| StdSummary {
            landmarks: sigma.header.landmarks,
            floor_mm: 1e3 * sigma.header.floor.sqrt(),
            noise_mm: 1e3 * sigma.noise.sqrt(),
        });
        let ripple = report
            .ripple
            .iter()
            .map(|(joint, cycles, amplitude)| Ripple {
                joint: *joint,
                cycles_per_turn: *cycles,
                amplitude_urad: 1e6 * amplitude,
            });
        let ambiguous = report.ambiguous.iter().map(|line| AmbiguousSummary {
            joint: line.joint + 1,
            cycles_per_turn: [line.cycles, line.alias],
        });
        Some(Self {
            noise_mm: 1e3 * report.position_noise,
            noise_mrad: samples
                .iter()
                .any(|s| s.observation.has_orientation())
                .then_some(1e3 * report.orientation_noise),
            inducing_points: report.inducing_points,
            search: SearchSummary {
                end: match report.search.end {
                    SearchEnd::Converged => "converged",
                    SearchEnd::IterationLimit => "iteration-limit",
                    SearchEnd::NoProgress => "no-progress",
                },
                iterations: report.search.iterations,
                poses: report.search.poses,
                evidence_rise_nats: report.search.rise,
            },
            ripple: ripple.collect(),
            ambiguous_ripple: ambiguous.collect(),
            own_joint_curve: report.curve.map(|curve| CurveSummary {
                amplitude_urad: 1e6 * curve.amplitude,
                length_scale_deg: curve.length_scale.to_degrees(),
                orders: curve.orders,
            }),
            warm_up: calibration.warm_up.as_ref().map(|w| w.report.clone()),
            single_precision_cost_um: report.single_precision_cost.map(|m| 1e6 * m),
            predictive_std: sigma,
            predictive_std_wanted: config.device_variance && config.method == Method::Elastic,
        })
    }

    /// Returns the own-joint curve for the HTML report: amplitude in µrad, lengthscale in degrees, number of orders.
    pub fn listed_curve(&self) -> Option<(f64, f64, usize)> {
        let curve = self.own_joint_curve.as_ref()?;
        Some((curve.amplitude_urad, curve.length_scale_deg, curve.orders))
    }

    /// Returns the standard deviation of one component, mm and mrad.
    pub fn noise(&self) -> [Option<f64>; 2] {
        [Some(self.noise_mm), self.noise_mrad]
    }

    /// Prints the summary.
    pub fn print(&self, report: Printer) {
        let orientation = self
            .noise_mrad
            .map_or(String::new(), |mrad| format!(", {mrad:.4} mrad"));
        report.line(format_args!(
            "  fitted noise of one component: {:.4} mm{orientation}",
            self.noise_mm
        ));
        let search = &self.search;
        report.line(format_args!(
            "  hyperparameters: the search over {} poses {} after {} iterations; processes raise the log evidence by {:.0} nats",
            search.poses,
            match search.end {
                "converged" => "converged",
                "iteration-limit" => "was stopped",
                _ => "found no better step",
            },
            search.iterations,
            search.evidence_rise_nats
        ));
        if let Some(sigma) = &self.predictive_std {
            report.line(format_args!(
                "  the device's standard deviation is at least {:.4} mm, of which the noise is {:.4} mm",
                sigma.floor_mm, sigma.noise_mm
            ));
        } else if self.predictive_std_wanted {
            report.line(
                "  note: no standard deviation for the device: its equations cannot be solved",
            );
        }
        if let Some(cost) = self.single_precision_cost_um {
            report.line(format_args!(
                "  single precision needs smaller weights, which move predictions of these measurements by {cost:.2} µm RMS"
            ));
        }
        if let Some(curve) = &self.own_joint_curve {
            report.line(format_args!(
                "  own-joint curve: {:.0} µrad standard deviation, lengthscale {:.1}°, up to {} cycles per turn",
                curve.amplitude_urad, curve.length_scale_deg, curve.orders
            ));
        }
        if let Some(found) = &self.warm_up {
            report.line(format_args!("  {}", found.line()));
        }
        for r in &self.ripple {
            report.line(format_args!(
                "  gear ripple of joint {}: {:.1} cycles per turn, {:.0} µrad",
                r.joint, r.cycles_per_turn, r.amplitude_urad
            ));
        }
        for line in &self.ambiguous_ripple {
            let [one, other] = line.cycles_per_turn;
            report.line(format_args!(
                "  no gear ripple of joint {} is in the model: {one:.1} and {other:.1} cycles per turn fit the \
                 measured angles equally; poses with joint {} between these angles would decide",
                line.joint, line.joint
            ));
        }
    }
}
