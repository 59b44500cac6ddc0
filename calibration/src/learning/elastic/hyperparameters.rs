//! The hyperparameters of the elastic model: their positions in one flat vector of logarithms, the start and bounds of a
//! search, and the kernels that they define.

use poegp_runtime::gp::joint_kernel::JointKernel;

use crate::learning::elastic::own_joint_curve::{CurvePrior, LENGTH_SCALES, Spectrum};

/// Unit of the processes, in rad or m of deflection: amplitudes in this unit are of order one.
pub const DEFLECTION_UNIT: f64 = 1e-4;

/// Layout of the hyperparameters, a flat vector of natural logarithms: noise (position, orientation), priors (frames,
/// links, payload), then w_d…, w_m, a₀, a₁ of each output, and a² and l of the own-joint curve, if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HyperLayout {
    /// Number of outputs: the joints.
    pub joints: usize,
    /// Whether the payload is an input.
    pub payload: bool,
    /// Whether there is an own-joint curve.
    pub curve: bool,
}

/// Number of noise and prior hyperparameters, which precede those of the kernels.
pub const COMMON: usize = 5;

/// Prior standard deviation of the logarithms of one input's weights about their mean over the joints. A narrower prior,
/// or an inferred spread, is better with sixty poses of the wild arm, but with 8 to 30 poses of other arms it chooses or
/// covers worse.
const SPREAD: f64 = 2.0;

impl HyperLayout {
    /// Returns the number of hyperparameters.
    pub fn len(&self) -> usize {
        self.curve_amplitude() + if self.curve { 2 } else { 0 }
    }

    /// Returns the index of a² of the own-joint curve, which is in squared units of the processes.
    pub fn curve_amplitude(&self) -> usize {
        COMMON + (self.scales_len() + self.amplitudes_len()) * self.joints
    }

    /// Returns the index of the lengthscale of the own-joint curve, which is in rad.
    pub fn curve_scale(&self) -> usize {
        self.curve_amplitude() + 1
    }

    /// Returns the prior of the own-joint curve in units of the processes; `None` without a curve.
    pub fn curve_prior(&self, h: &[f64]) -> Option<CurvePrior> {
        self.curve.then(|| CurvePrior {
            amplitude: libm::exp(h[self.curve_amplitude()]),
            spectrum: Spectrum::new(libm::exp(h[self.curve_scale()])),
        })
    }

    /// Returns false: a layout is never empty.
    pub fn is_empty(&self) -> bool {
        false
    }

    fn scales_len(&self) -> usize {
        self.joints + usize::from(self.payload)
    }

    fn amplitudes_len(&self) -> usize {
        1 + usize::from(self.payload)
    }

    /// Returns the index of w_d of output c (`d == joints`: w_m).
    pub fn scale(&self, c: usize, d: usize) -> usize {
        COMMON + c * self.scales_len() + d
    }

    /// Returns the index of a₀ (`i == 0`) or a₁ (`i == 1`) of output c.
    pub fn amplitude(&self, c: usize, i: usize) -> usize {
        COMMON + self.scales_len() * self.joints + c * self.amplitudes_len() + i
    }

    /// Returns the start of a search and its bounds.
    pub fn start_and_bounds(&self, payload_unit: f64) -> (Vec<f64>, Vec<(f64, f64)>) {
        let mut start = vec![0.0; self.len()];
        let mut bounds = vec![(0.0, 0.0); self.len()];
        let mut set = |i: usize, value: f64, lower: f64, upper: f64| {
            start[i] = libm::log(value);
            bounds[i] = (libm::log(lower), libm::log(upper));
        };
        for i in 0..2 {
            set(i, 0.5, 1e-4, 1e2);
        }
        for i in 2..COMMON {
            // Variances relative to the prior's.
            set(i, 1.0, 1e-4, 1e2);
        }
        let unit = payload_unit * payload_unit;
        for c in 0..self.joints {
            for d in 0..self.joints {
                set(self.scale(c, d), 0.3, 1e-3, 1e2);
            }
            set(self.amplitude(c, 0), 0.3, 1e-6, 1e4);
            if self.payload {
                set(
                    self.scale(c, self.joints),
                    0.3 / unit,
                    1e-3 / unit,
                    1e2 / unit,
                );
                set(self.amplitude(c, 1), 0.3 / unit, 1e-6 / unit, 1e4 / unit);
            }
        }
        if self.curve {
            set(self.curve_amplitude(), 4.0, 1e-4, 1e4);
            let (shortest, longest) = LENGTH_SCALES;
            set(self.curve_scale(), 0.15, shortest, longest);
        }
        (start, bounds)
    }

    /// Returns `h` with processes that explain nothing: their amplitudes are at the lower `bounds`.
    pub fn without_processes(&self, h: &[f64], bounds: &[(f64, f64)]) -> Vec<f64> {
        let mut out = h.to_vec();
        for c in 0..self.joints {
            for i in 0..self.amplitudes_len() {
                let at = self.amplitude(c, i);
                out[at] = bounds[at].0;
            }
        }
        out
    }

    /// Returns the kernels of all outputs, with amplitudes in rad² (m²).
    pub fn kernels(&self, h: &[f64]) -> Vec<JointKernel<f64>> {
        let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
        (0..self.joints)
            .map(|c| {
                let weights: Vec<f64> = (0..self.joints)
                    .map(|d| libm::exp(h[self.scale(c, d)]))
                    .collect();
                let (wm, a1) = if self.payload {
                    (
                        libm::exp(h[self.scale(c, self.joints)]),
                        libm::exp(h[self.amplitude(c, 1)]),
                    )
                } else {
                    (0.0, 0.0)
                };
                JointKernel::from_natural(
                    &weights,
                    wm,
                    unit * libm::exp(h[self.amplitude(c, 0)]),
                    unit * a1,
                )
            })
            .collect()
    }

    /// Returns the negative log prior of the lengthscales, up to a constant, and adds its gradient to `gradient`.
    pub fn add_scale_prior(&self, h: &[f64], gradient: &mut [f64]) -> f64 {
        let precision = 1.0 / (SPREAD * SPREAD);
        let mut squares = 0.0;
        for input in 0..self.scales_len() {
            let at = |joint: usize| self.scale(joint, input);
            let mean = (0..self.joints).map(|c| h[at(c)]).sum::<f64>() / self.joints as f64;
            for joint in 0..self.joints {
                let off = h[at(joint)] - mean;
                squares += off * off;
                // The terms of the gradient that stem from the mean add up to zero.
                gradient[at(joint)] += precision * off;
            }
        }
        0.5 * precision * squares
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Alike is most likely, whatever the lengthscales are; and the gradient is that of differences.
    #[test]
    fn length_scales_that_are_alike_are_most_likely() {
        let layout = HyperLayout {
            joints: 5,
            payload: true,
            curve: true,
        };
        let (alike, _) = layout.start_and_bounds(4.0);
        let value = |h: &[f64]| layout.add_scale_prior(h, &mut vec![0.0; h.len()]);
        let mut shifted = alike.clone();
        for joint in 0..5 {
            shifted[layout.scale(joint, 2)] += 1.5;
        }
        assert!((value(&alike) - value(&shifted)).abs() < 1e-12);
        let mut apart = alike.clone();
        for (i, h) in apart.iter_mut().enumerate() {
            *h += libm::sin(1.7 * i as f64);
        }
        assert!(value(&apart) > value(&alike) + 1.0);
        let mut gradient = vec![0.0; apart.len()];
        layout.add_scale_prior(&apart, &mut gradient);
        for i in 0..apart.len() {
            let at = |step: f64| {
                let mut moved = apart.clone();
                moved[i] += step;
                value(&moved)
            };
            let difference = (at(1e-4) - at(-1e-4)) / 2e-4;
            assert!((gradient[i] - difference).abs() < 1e-7, "{i}");
        }
    }
}
