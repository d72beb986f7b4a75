//! Parameters of a fuser that describe the noise.

use attitude::{fuser::Fuser, parameters::Parameter, stage::Stage as _};

use super::report::{Estimate, Selector, SensorNoise};

/// Rule that sets a parameter from the measured noise.
enum Rule {
    /// The parameter is set to the measured value. The value must be determined on all axes.
    Measured,
    /// The parameter also covers errors that do not appear at rest, such as thermal bias drift or
    /// coning. A measured value replaces the default only if it is larger.
    AtLeastDefault,
}

/// Parameters: name, sensor, coefficient and rule.
const PARAMETERS: [(&str, &str, Selector, Rule); 5] = [
    ("level_noise_deg_sqrt_s", "gyro", |axis| &axis.random_walk, Rule::AtLeastDefault),
    ("gyro_noise_deg_sqrt_s", "gyro", |axis| &axis.random_walk, Rule::Measured),
    ("accel_noise_m_s_sqrt_s", "accelerometer", |axis| &axis.random_walk, Rule::Measured),
    ("gyro_bias_walk_deg_s_sqrt_s", "gyro", |axis| &axis.bias_walk, Rule::AtLeastDefault),
    ("accel_bias_walk_m_s2_sqrt_s", "accelerometer", |axis| &axis.bias_walk, Rule::AtLeastDefault),
];

/// Fuser parameters that were determined from the noise.
pub(super) struct Settings {
    /// Section for the launch file; empty if no parameter is determined.
    pub(super) block: String,
    pub(super) note: Option<String>,
}

/// Returns the parameters of the fuser `stage` that follow from the noise. Each parameter has one
/// value for all axes: that of the noisiest axis.
pub(super) fn from_noise(sensors: &[SensorNoise], stage: &str) -> Settings {
    let Some(fuser) = Fuser::from_name(stage) else {
        let note = format!("the fuser {stage} is not a built-in stage, so its parameters for noise are unknown");
        return Settings { block: String::new(), note: Some(note) };
    };
    let known = fuser.parameters();
    let find = |name: &str| known.iter().find(|parameter| parameter.name == name);
    let mut set = Vec::new();
    let mut kept = Vec::new();
    let mut has_parameter = false;
    for (name, sensor, estimate, rule) in PARAMETERS {
        let Some(Parameter { default, min, max, .. }) = find(name) else { continue };
        has_parameter = true;
        let (largest, is_complete) = largest(sensors, sensor, estimate);
        match (rule, largest) {
            (_, None) => {}
            (Rule::Measured, _) if !is_complete => {}
            (Rule::AtLeastDefault, Some(value)) if value <= *default => kept.push(name),
            (_, Some(value)) => set.push(format!("{name} = {}", rounded(value).clamp(*min, *max))),
        }
    }
    let note = if !has_parameter {
        Some(format!("the fuser {stage} has no parameter for noise"))
    } else if kept.is_empty() {
        set.is_empty().then(|| "no parameter of the fuser follows, because not all axes are determined".into())
    } else {
        Some(format!("larger defaults, which include errors that a rest does not show, are kept: {}", kept.join(", ")))
    };
    let block = match set.is_empty() {
        true => String::new(),
        false => format!("[fuser]\nstage = \"{stage}\"\nset = {{ {} }}\n", set.join(", ")),
    };
    Settings { block, note }
}

/// Returns the largest determined value among the axes of `sensor`, and `true` if the value of
/// every axis is determined.
fn largest(sensors: &[SensorNoise], sensor: &str, estimate: Selector) -> (Option<f64>, bool) {
    let axes = sensors.iter().filter(|noise| noise.sensor == sensor).flat_map(|noise| &noise.axes);
    let values = axes.map(|axis| match estimate(axis) {
        Estimate::Determined { value, .. } => Some(*value),
        Estimate::NotDetermined { .. } => None,
    });
    let is_complete = values.clone().all(|value| value.is_some());
    (values.flatten().reduce(f64::max), is_complete)
}

/// Rounds a value to three significant digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
