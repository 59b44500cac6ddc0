//! The findings against a calibration by touches, as text for the user.

use crate::identification::touch::judge::{EXPECTED_RATIO, LEFT_OUT_RATIO, PLAY, WORSE};
use crate::model::touches::summary::TouchSummary;
use crate::trust::{Finding, Findings, Tier};
use poegp_protocol::cause::Cause;

/// Factor by which an arm may be farther from its drawing than its class before a finding reports it.
const BEYOND: f64 = 1.3;
/// Share of the sum of squares above which a finding names a feature.
const ALONE: f64 = 0.5;

/// Returns the findings against a calibration by touches.
pub fn findings(summary: &TouchSummary) -> Findings {
    let mut out = Findings::default();
    let mut add = |cause, tier, text: String, rows: Vec<usize>, value, threshold| {
        out.0.push(Finding {
            cause,
            tier,
            text,
            rows,
            value,
            threshold,
        });
    };
    let unit = summary.left_out_unit;
    let [drawn, calibrated] = summary.left_out;
    if summary.left_out_ratio >= LEFT_OUT_RATIO {
        add(
            Cause::Gain,
            Tier::Refused,
            format!(
                "touches that are left out miss by {calibrated:.3} {unit} with the arm calibrated by the others and by {drawn:.3} {unit} with \
                 the drawing: a ratio of {:.2}, which must be below {LEFT_OUT_RATIO}; touch more often and in more orientations, and \
                 look for a tool that slips or joints that play",
                summary.left_out_ratio
            ),
            Vec::new(),
            summary.left_out_ratio,
            LEFT_OUT_RATIO,
        );
    }
    let expected = summary.after.mean_mm / summary.before.mean_mm;
    if expected >= EXPECTED_RATIO {
        let remedy = summary.unseen.first().map_or(
            "touch more often, in orientations that differ more, and give a known distance",
            |unseen| unseen.text.as_str(),
        );
        add(
            Cause::Gain,
            Tier::Refused,
            format!(
                "these touches show too little: {:.2} mm are expected over the work volume after them and {:.2} mm before; {remedy}",
                summary.after.mean_mm, summary.before.mean_mm
            ),
            Vec::new(),
            expected,
            EXPECTED_RATIO,
        );
    }
    if summary.worse_probability >= WORSE {
        add(
            Cause::Gain,
            Tier::Refused,
            format!(
                "with a probability of {:.0} % this arm is worse off calibrated than as drawn, which must be below {:.0} %: the touches \
                 determine too few of its errors; touch more often and in more orientations, or add a socket or a draw-wire",
                100.0 * summary.worse_probability,
                100.0 * WORSE
            ),
            Vec::new(),
            summary.worse_probability,
            WORSE,
        );
    }
    if let Some(tau) = summary.play_mm {
        add(
            Cause::Noise,
            Tier::Warning,
            format!(
                "touches scatter by {tau:.2} mm beyond their stated noise: joints with play, or a tool that slipped"
            ),
            Vec::new(),
            tau,
            1e3 * PLAY.1,
        );
    }
    if let Some(factor) = summary.beyond_class.filter(|f| *f > BEYOND) {
        add(
            Cause::Frames,
            Tier::Note,
            format!(
                "this arm is {factor:.1} times as far from its drawing as its class is stated to be: the expected error is widened"
            ),
            Vec::new(),
            factor,
            BEYOND,
        );
    }
    if !summary.outliers.is_empty() {
        let lines: Vec<usize> = summary.outliers.iter().map(|o| o.line).collect();
        let each: Vec<String> = summary
            .outliers
            .iter()
            .take(LISTED)
            .map(|o| format!("line {} by {:.2} {}", o.line, o.error, o.unit))
            .collect();
        let more = match lines.len().saturating_sub(LISTED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        add(
            Cause::Outlier,
            Tier::Warning,
            format!(
                "{} of {} rows do not belong and were left out: {}{more}",
                lines.len(),
                summary.rows,
                each.join(", ")
            ),
            lines.clone(),
            lines.len() as f64,
            0.0,
        );
    }
    if summary.features.len() > 1 {
        let equations: usize = summary.features.iter().map(|f| f.equations).sum();
        for feature in summary.features.iter().filter(|f| {
            // A touch of a socket leaves three residual components; a touch of a plane or a wire leaves one.
            let even = f.equations as f64 / equations.max(1) as f64;
            f.share > ALONE && f.share > 2.0 * even
        }) {
            add(
                Cause::Outlier,
                Tier::Warning,
                format!(
                    "\"{}\" alone has {:.0} % of what is left in all touches: was it moved, or is it two features under one name?",
                    feature.name,
                    100.0 * feature.share
                ),
                Vec::new(),
                feature.share,
                ALONE,
            );
        }
    }
    out.accept(&[]);
    out
}

/// Largest number of rows that a finding lists.
const LISTED: usize = 8;
