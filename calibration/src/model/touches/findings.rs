//! The findings against a calibration by touches, as text for the user.

use crate::identification::touch::judge::{EXPECTED_RATIO, LEFT_OUT_RATIO, WORSE};
use crate::model::touches::summary::{TouchOutlier, TouchSummary};
use crate::trust::{Finding, Findings, Tier};
use poegp_protocol::cause::Cause;

/// Factor by which an arm may be farther from its nominal model than its class before a finding reports it.
const BEYOND: f64 = 1.3;
/// Share of the sum of squares above which a finding names a feature.
const ALONE: f64 = 0.5;
/// Errors of the joints in each image from which on a finding reports them, mrad.
const SCATTERED: f64 = 0.4;

/// Returns the findings against a calibration by touches.
pub fn findings(summary: &TouchSummary) -> Findings {
    let mut out = Vec::new();
    let refused = |text, value, limit| Finding::new(Cause::Gain, Tier::Refused, text, value, limit);
    let unit = summary.left_out_unit;
    let [nominal, calibrated] = summary.left_out;
    if summary.left_out_ratio >= LEFT_OUT_RATIO {
        let text = format!(
            "touches that were left out miss {:.2} times as far with the arm calibrated by the others as with the nominal \
             model (all kinds, in units of their noise; limit {LEFT_OUT_RATIO}). Those of the most frequent kind miss by \
             {calibrated:.3} {unit}, with the nominal model by {nominal:.3} {unit}: touch more often and in more \
             orientations, and look for a tool that slips or joints with play",
            summary.left_out_ratio
        );
        out.push(refused(text, summary.left_out_ratio, LEFT_OUT_RATIO));
    }
    let expected = summary.after.mean_mm / summary.before.mean_mm;
    if expected >= EXPECTED_RATIO {
        let remedy = summary.unseen.first().map_or(
            "touch more often, in orientations that differ more, and give a known distance",
            |unseen| unseen.text.as_str(),
        );
        let text = format!(
            "these touches determine too little: over the work volume, the expected error is {:.2} mm after them \
             and {:.2} mm before; {remedy}",
            summary.after.mean_mm, summary.before.mean_mm
        );
        out.push(refused(text, expected, EXPECTED_RATIO));
    }
    if summary.worse_probability >= WORSE {
        let text = format!(
            "with a probability of {:.0} % (limit {:.0} %), calibration makes this arm worse: the touches \
             determine too few of its errors; touch more often and in more orientations, or add a socket or a \
             draw-wire",
            100.0 * summary.worse_probability,
            100.0 * WORSE
        );
        out.push(refused(text, summary.worse_probability, WORSE));
    }
    out.extend(of_noise(summary));
    if let Some(factor) = summary.beyond_class.filter(|f| *f > BEYOND) {
        let text = format!(
            "this arm deviates from its nominal model {factor:.1} times as much as stated for its class: the expected \
             error is enlarged to match"
        );
        let found = Finding::new(Cause::Frames, Tier::Note, text, factor, BEYOND);
        out.push(found);
    }
    if let Some(text) = outliers_text(&summary.outliers, summary.rows) {
        let lines: Vec<usize> = summary.outliers.iter().map(|o| o.line).collect();
        let count = lines.len() as f64;
        let found = Finding::new(Cause::Outlier, Tier::Warning, text, count, 0.0);
        out.push(found.of_rows(lines));
    }
    if summary.features.len() > 1 {
        let equations: usize = summary.features.iter().map(|f| f.equations).sum();
        for feature in summary.features.iter().filter(|f| {
            // A touch of a socket leaves three residual components; a touch of a plane or a wire leaves one.
            let even = f.equations as f64 / equations.max(1) as f64;
            f.share > ALONE && f.share > 2.0 * even
        }) {
            let text = format!(
                "\"{}\" alone has {:.0} % of the squared residuals of all touches: was it moved, or is it two \
                 features under one name?",
                feature.name,
                100.0 * feature.share
            );
            let found = Finding::new(Cause::Outlier, Tier::Warning, text, feature.share, ALONE);
            out.push(found);
        }
    }
    let mut out = Findings(out);
    out.accept(&[]);
    out
}

/// Returns the findings about rows that miss by more than their noise.
fn of_noise(summary: &TouchSummary) -> Vec<Finding> {
    let mut out = Vec::new();
    for noise in summary.noise.iter().filter(|noise| noise.is_loud) {
        let text = format!(
            "rows of kind {kind} miss by {:.2} {unit} beyond the stated {:.2} {unit}: {}",
            noise.beyond,
            noise.stated,
            suspected(noise.kind),
            kind = noise.kind,
            unit = noise.unit
        );
        let found = Finding::new(
            Cause::Noise,
            Tier::Warning,
            text,
            noise.beyond,
            noise.stated,
        );
        out.push(found);
    }
    if let Some(mrad) = summary.joint_scatter_mrad.filter(|mrad| *mrad > SCATTERED) {
        let text = format!(
            "the images agree only if every joint errs by {mrad:.2} mrad in each of them (limit {SCATTERED} mrad): the squares \
             of the board or the camera's focal length are not as stated, or the joints have play"
        );
        out.push(Finding::new(
            Cause::Noise,
            Tier::Warning,
            text,
            mrad,
            SCATTERED,
        ));
    }
    out
}

/// Returns what may be wrong where rows of this kind miss by more than their noise.
fn suspected(kind: &str) -> String {
    let of_kind = match kind {
        "plane" => "the plates are not as flat as stated (flatness_mm)",
        "sphere" => "the balls are not as round, or the bar not as stiff, as stated (roundness_mm)",
        "anchor" => "the wire is not as linear as stated (scale_sigma_ppm)",
        "point" => {
            "the ball does not seat itself in its socket in the same way each time (seat_mm)"
        }
        "level" => {
            return "gx, gy and gz are exchanged or reversed, or the sensor moved on its mount; the fit hardly uses the level"
                .to_owned();
        }
        _ => "the instrument is noisier than stated",
    };
    format!(
        "{of_kind}, or the joints have play, or the tool slips; the expected error is enlarged to match"
    )
}

/// Largest number of rows that a sentence lists.
const LISTED: usize = 8;

/// Lists the rows that contradict the others in a sentence; `None` if there are none.
pub fn outliers_text(outliers: &[TouchOutlier], rows: usize) -> Option<String> {
    let text = |o: &TouchOutlier| format!("line {} by {:.2} {}", o.line, o.error, o.unit);
    let each: Vec<String> = outliers.iter().take(LISTED).map(text).collect();
    let more = match outliers.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    (!outliers.is_empty()).then(|| {
        format!(
            "{} of {rows} rows are outliers and were left out: {}{more}",
            outliers.len(),
            each.join(", ")
        )
    })
}
