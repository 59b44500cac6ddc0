//! The settings of a calibration: everything that is needed to repeat it, apart from the data.
//!
//! A project file uses the field names as keys, so each field has the unit that its name states. In TOML:
//!
//! ```
//! use poegp_calibration::model::config::Config;
//!
//! let config: Config = toml::from_str("method = \"elastic\"\ninducing_points = 150")?;
//! assert_eq!(config.inducing_points, 150);
//! assert_eq!(config.gravity_m_s2, [0.0, 0.0, -9.81]);
//! assert!(toml::from_str::<Config>("inducing_point = 100").is_err());
//! # Ok::<(), toml::de::Error>(())
//! ```

use serde::{Deserialize, Serialize};

use crate::learning::elastic::options::{
    ElasticOptions, HYPERPARAMETER_POSES, INDUCING_POINTS, InducingLimits, OutlierPolicy,
    WarmUpPolicy,
};
use crate::learning::task_space::fit::HyperparameterSharing;
use crate::measurement::noise::InstrumentNoise;
use crate::model::methods::Method;
pub use crate::model::methods::problem::Weighting;
use crate::robot::toml_source::exactly;

/// The settings of a calibration. [`Config::default`] is the elastic model with the default settings of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    default,
    deny_unknown_fields,
    expecting = "the table of a calibration with its keys"
)]
pub struct Config {
    /// The calibration method.
    pub method: Method,
    /// How the poses are weighted in the frame fit of the methods `poe`, `poe-gp` and `poe-gp-load`.
    pub weighting: Weighting,
    /// Whether the six outputs of the task-space process share their hyperparameters.
    pub hyperparameters: HyperparameterSharing,
    /// Upper limit on the inducing points of the elastic model, summed over all joints.
    pub inducing_points: usize,
    /// Upper limit on the instructions that the inducing points cost a Cortex-M4F in one evaluation, according to the cost
    /// model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_point_instructions: Option<u64>,
    /// Whether the elastic model stores a position variance for the device.
    pub device_variance: bool,
    /// Whether the elastic model has gravity torques of links and payload.
    pub gravity_terms: bool,
    /// Whether the elastic model has gear ripple.
    pub ripple: bool,
    /// Whether the elastic model may have own-joint curves; it has one only where the evidence supports it.
    pub curve: bool,
    /// Upper limit on the poses that the hyperparameters of the elastic model are learnt from; the folds of a model
    /// selection learn from fewer.
    #[serde(skip)]
    pub hyperparameter_poses: usize,
    /// What is done with outliers.
    pub outliers: OutlierPolicy,
    /// What the elastic model does with the warm-up that the evidence shows.
    pub warm_up: WarmUpPolicy,
    /// Gravity in the base frame, m/s².
    #[serde(deserialize_with = "exactly")]
    pub gravity_m_s2: [f64; 3],
    /// Standard deviation of one position component as the instrument's manufacturer states it, in mm. `None`: the value that the
    /// rows of the measurement file declare; if they declare none, it is estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_sigma_mm: Option<f64>,
    /// Standard deviation of one rotation component as the instrument's manufacturer states it, in mrad. `None`: the value that the
    /// rows of the measurement file declare; if they declare none, it is estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation_sigma_mrad: Option<f64>,
    /// Upper limit on the displacement of the tool by the correction, in mm. `None`: twice the largest in training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_correction_mm: Option<f64>,
    /// Upper limit on the rotation of the tool by the correction, in mrad. `None`: twice the largest in training.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_correction_mrad: Option<f64>,
}

/// A value of a [`Config`] that is out of its range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` is {found}: expected {expected}")]
pub struct ConfigError {
    /// The key, as it is written in TOML.
    pub key: &'static str,
    /// The value that was found.
    pub found: String,
    /// The values that the key accepts.
    pub expected: String,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            method: Method::Elastic,
            weighting: Weighting::default(),
            hyperparameters: HyperparameterSharing::default(),
            inducing_points: INDUCING_POINTS,
            max_point_instructions: None,
            device_variance: true,
            gravity_terms: true,
            ripple: true,
            curve: true,
            hyperparameter_poses: HYPERPARAMETER_POSES,
            outliers: OutlierPolicy::default(),
            warm_up: WarmUpPolicy::default(),
            gravity_m_s2: [0.0, 0.0, -9.81],
            position_sigma_mm: None,
            orientation_sigma_mrad: None,
            max_correction_mm: None,
            max_correction_mrad: None,
        }
    }
}

impl Config {
    /// Creates the default settings with the given method.
    pub fn new(method: Method) -> Self {
        Self {
            method,
            ..Self::default()
        }
    }

    /// Checks the ranges of the values, which the types of the fields do not enforce.
    ///
    /// # Errors
    /// [`ConfigError`] for the first value that is out of its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let error = |key, found: &dyn std::fmt::Debug, expected: String| {
            let found = format!("{found:?}");
            Err(ConfigError {
                key,
                found,
                expected,
            })
        };
        let limits = [
            ("position_sigma_mm", self.position_sigma_mm, f64::INFINITY),
            (
                "orientation_sigma_mrad",
                self.orientation_sigma_mrad,
                f64::INFINITY,
            ),
            ("max_correction_mm", self.max_correction_mm, 1000.0),
            ("max_correction_mrad", self.max_correction_mrad, 500.0),
        ];
        for (key, value, limit) in limits {
            let Some(x) = value else { continue };
            if !(x > 0.0 && x.is_finite() && x <= limit) {
                let at_most = match limit.is_finite() {
                    true => format!(" and at most {limit}"),
                    false => String::new(),
                };
                return error(key, &x, format!("a number above 0{at_most}"));
            }
        }
        let g = self.gravity_m_s2;
        if !g.iter().all(|x| x.is_finite()) {
            return error("gravity_m_s2", &g, "three finite numbers in m/s²".into());
        }
        let most = MAX_INDUCING_POINTS;
        match (1..=most).contains(&self.inducing_points) {
            true => Ok(()),
            false => error(
                "inducing_points",
                &self.inducing_points,
                format!("a number from 1 to {most}"),
            ),
        }
    }

    /// Returns the instrument noise that the settings state, which applies to all measurements.
    pub fn instrument_noise(&self) -> InstrumentNoise {
        InstrumentNoise {
            position: self.position_sigma_mm.map(|x| 1e-3 * x),
            orientation: self.orientation_sigma_mrad.map(|x| 1e-3 * x),
        }
    }

    /// Returns the part of the settings that the elastic fit reads.
    pub(crate) fn elastic(&self) -> ElasticOptions {
        ElasticOptions {
            gravity_terms: self.gravity_terms,
            processes: self.method != Method::Parametric,
            ripple: self.ripple,
            curve: self.curve,
            gravity: self.gravity_m_s2.into(),
            inducing: InducingLimits {
                points: self.inducing_points,
                instructions: self.max_point_instructions,
            },
            hyperparameter_poses: self.hyperparameter_poses,
            outliers: self.outliers,
            device_variance: self.device_variance,
            warm_up: self.warm_up,
        }
    }
}

/// Upper bound on [`Config::inducing_points`], summed over all joints.
pub const MAX_INDUCING_POINTS: usize = 2_000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_written_and_read_again() {
        let other = Config {
            max_point_instructions: Some(9000),
            position_sigma_mm: Some(0.015),
            orientation_sigma_mrad: Some(0.02),
            max_correction_mm: Some(4.0),
            max_correction_mrad: Some(8.0),
            weighting: Weighting::Noise,
            hyperparameters: HyperparameterSharing::PerOutput,
            outliers: OutlierPolicy::Keep,
            warm_up: WarmUpPolicy::Keep,
            ..Config::new(Method::PoeGpLoad)
        };
        for config in [Config::default(), other] {
            let text = toml::to_string(&config).unwrap();
            assert_eq!(toml::from_str::<Config>(&text).unwrap(), config, "{text}");
            config.validate().unwrap();
        }
        assert_eq!(toml::from_str::<Config>("").unwrap(), Config::default());
    }

    #[test]
    fn a_value_out_of_range_is_rejected_by_its_key() {
        for (text, message) in [
            (
                "max_correction_mm = -1",
                "`max_correction_mm` is -1.0: expected a number above 0 and at most 1000",
            ),
            (
                "position_sigma_mm = inf",
                "`position_sigma_mm` is inf: expected a number above 0",
            ),
            (
                "inducing_points = 0",
                "`inducing_points` is 0: expected a number from 1 to 2000",
            ),
            (
                "gravity_m_s2 = [0, 0, nan]",
                "`gravity_m_s2` is [0.0, 0.0, NaN]: expected three finite numbers in m/s²",
            ),
        ] {
            let config: Config = toml::from_str(text).unwrap();
            assert_eq!(config.validate().unwrap_err().to_string(), message);
        }
    }
}
