//! Examines whether all lengths are wrong by one ratio: a scale bar, a temperature or a camera, or an arm of another size.
//!
//! The frames take up the ratio, so the data alone do not show it. Their priors do: the errors of manufactured links are
//! independent, and it is unlikely that all links are longer in proportion.

use poegp_protocol::cause::Cause;

use crate::numeric::matrix::Mat;
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;

/// Ratio less 1 from which a warning is given: measured arms have up to 0.1 %.
const WARNED: f64 = 2.5e-3;
/// Ratio less 1 from which the file is refused: beyond any arm.
const REFUSED: f64 = 10e-3;
/// Ratio less 1, in standard deviations according to the priors, that the errors of arms explain. The priors are 2.5 times
/// as wide as the errors of the worst arms, so that this is nearly four standard deviations of theirs.
const EXPLAINED: f64 = 1.5;
/// Share of the frames' displacements that the ratio must explain: one link that is too long is no ratio.
const SHARE: f64 = 0.6;

/// Returns a warning or a refusal if the positions are those of a larger or a smaller arm.
pub fn examine(geometry: &Geometry) -> Option<Finding> {
    let Ratio { ratio, sd, share } = Ratio::of(geometry)?;
    let is_clear = ratio.abs() > WARNED.max(EXPLAINED * sd) && share > SHARE;
    is_clear.then(|| {
        let text = format!(
            "the positions are {:.2} % {} than those of the nominal robot: is the unit, the scale bar or the \
             temperature compensation right, or is it another arm?",
            100.0 * ratio.abs(),
            if ratio > 0.0 { "larger" } else { "smaller" }
        );
        let tier = Tier::refused_if(ratio.abs() > REFUSED);
        Finding::new(Cause::Unit, tier, text, ratio.abs(), WARNED)
    })
}

/// The common ratio of all lengths to the nominal model.
struct Ratio {
    /// The ratio less 1.
    ratio: f64,
    /// Its standard deviation, according to the priors.
    sd: f64,
    /// Share of the frames' displacements that it explains.
    share: f64,
}

impl Ratio {
    /// Returns the ratio that best explains the frames' displacements.
    ///
    /// With the deviations θ = e u + δ, where u is what a ratio of 1 adds and δ has the prior covariance Λ, an estimate θ̂
    /// with covariance C that was made with the prior of e = 0 gives e = uᵀ Λ⁻¹ θ̂ / uᵀ (Λ⁻¹ − Λ⁻¹ C Λ⁻¹) u.
    fn of(geometry: &Geometry) -> Option<Self> {
        let joints = geometry.state.layout.joints;
        // Base and tool take up the lengths before the first joint and after the last.
        let frames = geometry.state.frames.iter().enumerate();
        let mut weighted = Mat::zeros(geometry.sd.len(), 1);
        let (mut right, mut information, mut all) = (0.0, 0.0, 0.0);
        for (frame, pose) in frames.take(joints).skip(1) {
            for i in 0..3 {
                let at = 6 * frame + i;
                let length = pose.translation[i];
                let precision = geometry.sd[at].powi(-2);
                let deviation = geometry.state.deviation[at] + geometry.next_step[(at, 0)];
                weighted[(at, 0)] = precision * length;
                right += precision * length * deviation;
                information += precision * length * length;
                all += precision * deviation * deviation;
            }
        }
        information -= (weighted.transpose() * &geometry.covariance * &weighted)[(0, 0)];
        (information > 0.0 && all > 0.0).then(|| Self {
            ratio: right / information,
            sd: information.sqrt().recip(),
            share: right * right / (information * all),
        })
    }
}
