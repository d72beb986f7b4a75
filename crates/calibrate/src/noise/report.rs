//! Report of the noise: coefficients with confidence intervals, and the Allan deviations.

use std::fmt;

use serde::Serialize;

/// Confidence level of all intervals. It corresponds to ±1 standard deviation.
pub(super) const CONFIDENCE: f64 = 0.68;

/// Result of a noise calibration. Angles are in degrees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseReport {
    /// Kind of calibration: "noise".
    pub kind: &'static str,
    /// Confidence level of the intervals.
    pub confidence: f64,
    /// Median rate of the readings, Hz.
    pub rate_hz: f64,
    /// Parts of the recording that are used.
    pub rests: Vec<RestSpan>,
    /// Noise of gyro and accelerometer.
    pub sensors: Vec<SensorNoise>,
    /// Remarks for the user.
    pub notes: Vec<String>,
    /// Section for the launch file, TOML; empty if no parameter is determined.
    pub block: String,
}

/// Part of a recording, in seconds since its first reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RestSpan {
    /// Start, s.
    pub start_s: f64,
    /// End, s.
    pub end_s: f64,
}

impl RestSpan {
    pub(super) fn duration_s(&self) -> f64 {
        self.end_s - self.start_s
    }
}

/// Noise of a sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorNoise {
    /// "gyro", in °/s, or "accelerometer", in m/s².
    pub sensor: &'static str,
    /// Axes x, y and z.
    pub axes: Vec<AxisNoise>,
}

/// Noise of an axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisNoise {
    /// Name of the axis: x, y or z.
    pub axis: &'static str,
    /// Angle random walk, °/√s, or velocity random walk, m/s/√s.
    pub random_walk: Estimate,
    /// Bias instability, °/s or m/s². In its flat part, the Allan deviation is 0.664 times this
    /// value.
    pub bias_instability: Estimate,
    /// Rate random walk, °/s/√s, or acceleration random walk, m/s²/√s.
    pub bias_walk: Estimate,
    /// Allan deviations, by increasing τ.
    pub curve: Vec<AllanPoint>,
}

/// Selects a coefficient of an axis.
pub(super) type Selector = fn(&AxisNoise) -> &Estimate;

/// Estimate of a coefficient.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "result", rename_all = "snake_case")]
pub enum Estimate {
    /// The recording determines the coefficient.
    Determined {
        /// Value of the coefficient.
        value: f64,
        /// Lower and upper end of the confidence interval.
        interval: [f64; 2],
    },
    /// The recording is too short to determine the coefficient.
    NotDetermined {
        /// Upper limit at a confidence of 95 %.
        below: f64,
        /// Minutes for which the unit must rest to determine a coefficient as large as the limit.
        ///
        /// `None` if the duration is more than 64 times that of this recording.
        needs_min: Option<f64>,
    },
}

/// Allan deviation at an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AllanPoint {
    /// Interval τ, s.
    pub tau_s: f64,
    /// Allan deviation, °/s or m/s².
    pub deviation: f64,
    /// Lower and upper end of the confidence interval of the deviation.
    ///
    /// `None` if the interval τ is not part of the fit.
    pub interval: Option<[f64; 2]>,
    /// Allan deviation of the fitted model; `None` if the interval τ is not part of the fit.
    pub model: Option<f64>,
}

/// Returns the confidence interval of the square root of an estimate. The estimate has a χ²
/// distribution with the given degrees of freedom. The quantiles are those of Wilson and Hilferty
/// 1931.
pub(super) fn interval(square: f64, freedom: f64) -> (f64, f64) {
    let spread = 2.0 / (9.0 * freedom.max(1.0));
    let relative_quantile = |normal: f64| (1.0 - spread + normal * spread.sqrt()).max(0.05).powi(3);
    ((square / relative_quantile(1.0)).sqrt(), (square / relative_quantile(-1.0)).sqrt())
}

impl NoiseReport {
    /// Returns the estimates as text, without the section for the launch file.
    pub fn summary(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_summary(&mut text);
        text
    }

    fn write_summary(&self, f: &mut dyn fmt::Write) -> fmt::Result {
        let total_s: f64 = self.rests.iter().map(RestSpan::duration_s).sum();
        let rests = crate::report::pluralize(self.rests.len(), "rest");
        let (rate_hz, percent) = (self.rate_hz, 100.0 * self.confidence);
        writeln!(f, "noise: {rests}, {total_s:.1} s at {rate_hz:.1} Hz; intervals of {percent:.0} % confidence")?;
        for SensorNoise { sensor, axes } in &self.sensors {
            let rows: [(&str, &str, Selector); 3] = match *sensor {
                "gyro" => [
                    ("angle random walk", "°/√s", |axis| &axis.random_walk),
                    ("bias instability", "°/s", |axis| &axis.bias_instability),
                    ("rate random walk", "°/s/√s", |axis| &axis.bias_walk),
                ],
                _ => [
                    ("velocity random walk", "m/s/√s", |axis| &axis.random_walk),
                    ("bias instability", "m/s²", |axis| &axis.bias_instability),
                    ("acceleration random walk", "m/s²/√s", |axis| &axis.bias_walk),
                ],
            };
            for (name, unit, estimate) in rows {
                writeln!(f, "  {sensor} {name}, {unit}")?;
                axes.iter().try_for_each(|axis| writeln!(f, "    {}  {}", axis.axis, estimate(axis)))?;
            }
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "  {note}"))
    }
}

impl fmt::Display for NoiseReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_summary(f)?;
        match self.block.as_str() {
            "" => Ok(()),
            block => write!(f, "\nAdd to launch.toml, keeping the other settings of [fuser]:\n\n{block}"),
        }
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Determined { value, interval: [low, high] } => {
                write!(f, "{}  ({} to {})", Rounded(*value), Rounded(*low), Rounded(*high))
            }
            Self::NotDetermined { below, needs_min: Some(needs_min) } => {
                write!(f, "not determined (below {}), needs {needs_min:.0} minutes", Rounded(*below))
            }
            Self::NotDetermined { below, needs_min: None } => {
                write!(f, "not determined (below {}), needs a much longer recording", Rounded(*below))
            }
        }
    }
}

/// Number displayed with three significant digits.
pub(super) struct Rounded(pub(super) f64);

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 == 0.0 || !self.0.is_finite() {
            return write!(f, "{}", self.0);
        }
        let magnitude = self.0.abs().log10().floor();
        let decimals = (2.0 - magnitude).clamp(0.0, 12.0) as usize;
        write!(f, "{:.decimals$}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interval_matches_quantiles_of_chi_square() {
        // Quantiles 0.1587 and 0.8413 of χ² with 10 degrees of freedom: 5.681 and 14.326.
        let (low, high) = interval(10.0, 10.0);
        assert!((low * low - 100.0 / 14.326).abs() < 0.03, "{low}");
        assert!((high * high - 100.0 / 5.681).abs() < 0.05, "{high}");
    }

    #[test]
    fn estimates_are_shown_with_three_digits() {
        let determined = Estimate::Determined { value: 0.004_567, interval: [0.0045, 12.345] };
        assert_eq!(determined.to_string(), "0.00457  (0.00450 to 12.3)");
        let unknown = |needs_min| Estimate::NotDetermined { below: 1e-4, needs_min }.to_string();
        assert_eq!(unknown(Some(90.0)), "not determined (below 0.000100), needs 90 minutes");
        assert!(unknown(None).ends_with("needs a much longer recording"));
    }
}
