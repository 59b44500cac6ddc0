//! Maps values to positions: linear and logarithmic axes with round ticks.

/// Spacing of the values on an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// Linear spacing.
    Linear,
    /// Logarithmic spacing, for values above 0.
    Log,
}

/// One axis of a plot.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Quantity on the axis, with its unit.
    pub label: String,
    /// Spacing of the values.
    pub scale: Scale,
    /// Value at the lower end.
    pub lower: f64,
    /// Value at the upper end.
    pub upper: f64,
}

/// Steps between ticks, as multiples of a power of ten.
const STEPS: [f64; 4] = [1.0, 2.0, 5.0, 10.0];
/// Approximate number of ticks on a linear axis.
const TICKS: f64 = 5.0;
/// Ratio of the largest error to the median error above which an axis of errors is logarithmic.
const WIDE: f64 = 12.0;

impl Axis {
    /// Creates a linear axis over `lower` … `upper`; an empty range is widened.
    pub fn linear(label: impl Into<String>, lower: f64, upper: f64) -> Self {
        let (lower, upper) = if upper > lower && (upper - lower).is_finite() {
            (lower, upper)
        } else {
            let middle = if lower.is_finite() { lower } else { 0.0 };
            (middle - 0.5, middle + 0.5)
        };
        Self {
            label: label.into(),
            scale: Scale::Linear,
            lower,
            upper,
        }
    }

    /// Creates a logarithmic axis over `lower` … `upper`, widened to 1, 2 or 5 times a power of ten.
    pub fn log(label: impl Into<String>, lower: f64, upper: f64) -> Self {
        let upper = if upper > 0.0 && upper.is_finite() {
            upper
        } else {
            1.0
        };
        let lower = lower.clamp(upper * 1e-4, upper * 0.5);
        Self {
            label: label.into(),
            scale: Scale::Log,
            lower: round_125(lower, false),
            upper: round_125(upper, true),
        }
    }

    /// Creates an axis for errors: linear from 0 or, where a few errors are much larger than most, logarithmic.
    pub fn errors(label: impl Into<String>, values: &[f64]) -> Self {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let (Some(most), false) = (sorted.last().copied(), sorted.is_empty()) else {
            return Self::linear(label, 0.0, 1.0);
        };
        let middle = poegp_calibration::numeric::statistics::percentile(&sorted, 0.5);
        if most > WIDE * middle && middle > 0.0 {
            Self::log(
                label,
                poegp_calibration::numeric::statistics::percentile(&sorted, 0.02),
                most,
            )
        } else {
            Self::linear(label, 0.0, 1.04 * most)
        }
    }

    /// Returns the position of a value: 0 at the lower end, 1 at the upper one; values beyond are at the ends.
    pub fn location(&self, value: f64) -> f64 {
        let share = match self.scale {
            Scale::Linear => (value - self.lower) / (self.upper - self.lower),
            Scale::Log => (value / self.lower).ln() / (self.upper / self.lower).ln(),
        };
        if share.is_nan() {
            return 0.0;
        }
        share.clamp(0.0, 1.0)
    }

    /// Returns the ticks with their labels: multiples of a step, or 1, 2 and 5 in every decade.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        match self.scale {
            Scale::Linear => {
                let step = round_125((self.upper - self.lower) / TICKS, true);
                let decimals = (-step.log10().floor()).max(0.0) as usize;
                let first = (self.lower / step - 1e-9).ceil() as i64;
                let last = (self.upper / step + 1e-9).floor() as i64;
                (first..=last)
                    .map(|i| (i as f64 * step, format!("{:.decimals$}", i as f64 * step)))
                    .collect()
            }
            Scale::Log => {
                let exponents =
                    self.lower.log10().floor() as i32..=self.upper.log10().ceil() as i32;
                let values = exponents.flat_map(|e| [1.0, 2.0, 5.0].map(|f| f * 10f64.powi(e)));
                let inside = |x: &f64| (self.lower * 0.999..=self.upper * 1.001).contains(x);
                values.filter(inside).map(|x| (x, plain(x))).collect()
            }
        }
    }
}

/// Returns which labels have room. `locations` are along the axis, `lengths` is the length of each label on it. Powers of
/// ten come first, then fives, then twos.
pub fn with_room(texts: &[String], locations: &[f64], lengths: &[f64]) -> Vec<bool> {
    let rank = |text: &String| {
        let digit = text.chars().find(|c| ('1'..='9').contains(c));
        ['1', '5', '2'].iter().position(|d| Some(*d) == digit)
    };
    let mut order: Vec<usize> = (0..texts.len()).collect();
    order.sort_by_key(|i| rank(&texts[*i]));
    let mut shown = vec![false; texts.len()];
    for i in order {
        let apart =
            |j: usize| (locations[i] - locations[j]).abs() >= 0.5 * (lengths[i] + lengths[j]);
        shown[i] = (0..texts.len()).filter(|j| shown[*j]).all(apart);
    }
    shown
}

/// Rounds upwards or downwards to 1, 2 or 5 times a power of ten.
pub fn round_125(value: f64, upwards: bool) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    let multiple = value / power;
    let fits = |s: &&f64| {
        if upwards {
            **s >= multiple * (1.0 - 1e-9)
        } else {
            **s <= multiple * (1.0 + 1e-9)
        }
    };
    let step = if upwards {
        STEPS.iter().find(fits)
    } else {
        STEPS.iter().rev().find(fits)
    };
    step.copied().unwrap_or(1.0) * power
}

/// Formats a number without needless digits: 0.05, 2, 100.
pub fn plain(x: f64) -> String {
    let decimals = (1.0 - x.abs().max(1e-12).log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{x:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: &Axis) -> Vec<String> {
        axis.ticks().into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_numbers_that_people_like() {
        let axis = Axis::linear("", 0.0, 0.113);
        assert_eq!(texts(&axis), ["0.00", "0.05", "0.10"]);
        let axis = Axis::linear("", -180.0, 180.0);
        assert_eq!(texts(&axis), ["-100", "0", "100"]);
        let axis = Axis::log("", 0.013, 1.7);
        assert_eq!((axis.lower, axis.upper), (0.01, 2.0));
        assert_eq!(
            texts(&axis),
            ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"]
        );
        // So are those of many decades.
        let wide = texts(&Axis::log("", 0.001, 4.0));
        assert_eq!(
            (wide.len(), wide[1].as_str(), wide[11].as_str()),
            (12, "0.002", "5")
        );
    }

    #[test]
    fn labels_without_room_are_left_out_and_powers_of_ten_stay() {
        let texts = ["1", "2", "5", "10", "20", "50", "100"].map(str::to_owned);
        let at = |scale: f64| [0.0, 0.301, 0.699, 1.0, 1.301, 1.699, 2.0].map(|x| scale * x);
        let shown = |scale: f64| -> Vec<&str> {
            let all = with_room(&texts, &at(scale), &[10.0; 7]);
            let kept = texts.iter().zip(all).filter(|t| t.1);
            kept.map(|t| t.0.as_str()).collect()
        };
        assert_eq!(shown(35.0), texts);
        assert_eq!(shown(30.0), ["1", "10", "100"]);
        // Where the labels are narrower than the others.
        let few = with_room(&texts, &at(30.0), &[10.0, 4.0, 4.0, 10.0, 10.0, 10.0, 10.0]);
        assert_eq!(few, [true, true, true, true, false, false, true]);
    }

    #[test]
    fn odd_values_have_a_place() {
        for axis in [
            Axis::linear("", f64::NAN, f64::NAN),
            Axis::linear("", 3.0, 3.0),
            Axis::log("", 0.0, 0.0),
            Axis::log("", f64::NAN, f64::INFINITY),
            Axis::errors("", &[]),
            Axis::errors("", &[0.0, 0.0]),
            Axis::errors("", &[0.0, 1e-9, 5.0]),
        ] {
            for value in [0.0, -1.0, 1e300, f64::NAN, f64::INFINITY] {
                assert!(
                    (0.0..=1.0).contains(&axis.location(value)),
                    "{axis:?} {value}"
                );
            }
            assert!(axis.ticks().len() < 30, "{axis:?}");
        }
    }
}
