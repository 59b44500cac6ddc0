//! What `trainer check` says of errors that no drift explains, and of orientations.

use poegp_calibration::verification::result::Report;
use poegp_calibration::verification::unexplained::{AS_EXPECTED, Unexplained};

/// How the errors that remain without the drift compare with what the model expects.
#[derive(Clone, Copy, Debug)]
pub enum Rest<'a> {
    /// They are as the model expects.
    AsExpected,
    /// It is not known what the model expects, or the rows are too few to be sure.
    Unknown,
    /// They are significantly larger.
    Excess(&'a Unexplained),
}

impl<'a> Rest<'a> {
    /// Returns what a check has found.
    pub fn of(found: &'a Report) -> Self {
        match &found.unexplained {
            Some(rest) if rest.is_excess => Self::Excess(rest),
            Some(rest) if rest.is_as_expected() => Self::AsExpected,
            _ => Self::Unknown,
        }
    }

    /// Returns what touches that scatter by this multiple of their stated noise show.
    pub fn of_touches(noise_factor: f64) -> Self {
        match noise_factor <= AS_EXPECTED {
            true => Self::AsExpected,
            false => Self::Unknown,
        }
    }
}

/// States the scatter beside what the model states of itself.
pub fn scatter(r: &Report) -> String {
    let states = |mm: f64| format!(" (the model states {mm:.4} mm)");
    match r.noise_mm {
        Some(noise_mm) => {
            let rotation =
                (r.noise_mrad).map_or(String::new(), |mrad| format!(" and {mrad:.4} mrad"));
            format!(
                "Scatter that the model does not explain: {noise_mm:.4} mm{rotation} per axis{}; model error estimated from \
                 these rows: {:.4} mm per axis.",
                (r.unexplained.and_then(|u| u.noise_mm)).map_or(String::new(), states),
                r.model_mm
            )
        }
        None => format!(
            "Scatter and error of the model together: {:.4} mm per axis{}; this model does not separate the two.",
            r.scatter_mm,
            (r.unexplained).map_or(String::new(), |u| states(u.expected_mm))
        ),
    }
}

/// Warns of errors that no drift explains.
pub fn warning(r: &Report) -> Option<String> {
    let rest = r.unexplained.filter(|rest| rest.is_excess)?;
    let (found, expected) = (rest.position_mm, rest.expected_mm);
    let times = format!("{:.1} times what the model expects", rest.factor);
    let sizes = format!("{found:.4} mm per axis, expected {expected:.4} mm");
    let errors = match r.changes.is_empty() && r.during.is_none() {
        true => format!("the errors are {times} ({sizes})"),
        false => {
            format!("without the drift that was found, the errors are still {times} ({sizes})")
        }
    };
    Some(format!(
        "{errors}: something changed that neither joint zeros nor base nor tool explain, such as links that grew with \
         temperature, a bent link, the instrument's scale or noise, or the payload. Measure and calibrate again"
    ))
}

/// Advises not to act on a drift that leaves more than the model expects.
pub fn doubtful(rest: &Unexplained, more: &str) -> String {
    format!(
        "the drift that was found does not explain the errors (without it {:.4} mm per axis remain, {:.4} mm are \
        expected) and is perhaps not their cause: do not reset a zero or change a frame because of it; {more}",
        rest.position_mm, rest.expected_mm
    )
}

/// Smallest ratio of the mean rotation error to the one without drift that is far above expectation.
const FAR: f64 = 2.0;

/// States that orientations were not judged, and warns where a drift turned them far.
pub fn orientation(r: &Report) -> Option<String> {
    let now = r.errors.orientation_mrad.as_ref()?.mean;
    let without = r.without_mrad.as_ref().map_or(now, |s| s.mean);
    Some(match now > FAR * without {
        true => format!(
            "warning: orientation was not judged, but its mean error is {now:.3} mrad and would be {without:.3} mrad without the \
             drift. --tolerance-mrad judges it."
        ),
        false => {
            "Orientation was not judged: --max-mm limits positions, --tolerance-mrad orientations."
                .to_owned()
        }
    })
}
