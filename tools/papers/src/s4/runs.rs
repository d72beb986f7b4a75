//! Runs the levelling stages on a simulated cruise. Collects signed errors with continuous GNSS,
//! with gaps and without GNSS.

use attitude::{
    accel::Accelerometer,
    course::{Course, CourseInput},
    fuser::{Fuser, FuserInput},
    gyro::{Gyro, RateSample},
    metrics::AngleError,
    stage::Stage,
};
use scenario::Scenario;

/// Duration of a flight in seconds, as in the paper.
pub(crate) const DURATION_S: f64 = 3500.0;
/// Stages that are compared. `levelling` applies the control law of the paper to a single platform.
/// `levelling-unified` implements figure 7 of the paper.
pub(crate) const STAGES: [&str; 4] = ["levelling", "levelling-unified", "levelling-pi", "aided"];
/// Number of flights that are averaged for the table.
pub(crate) const SEEDS: u64 = 4;
/// Maximum age of the last fix, s. An older fix means a gap.
const FIX_TIMEOUT_S: f64 = 1.5;
/// Decimation factor of the plotted samples.
const PLOT_DECIMATION: usize = 10;

/// Availability of GNSS fixes during a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GnssCoverage {
    /// Continuous fixes.
    Always,
    /// Gaps of 60 s, which start at 300 s and then every 240 s.
    Gaps,
    /// No fixes.
    Never,
}

impl GnssCoverage {
    pub(crate) const ALL: [Self; 3] = [Self::Always, Self::Gaps, Self::Never];

    fn key(self) -> &'static str {
        match self {
            Self::Always => "always",
            Self::Gaps => "gaps",
            Self::Never => "never",
        }
    }
}

/// Sums of squared errors of roll, pitch, heading and course, degrees².
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SquaredErrors {
    roll: f64,
    pitch: f64,
    heading: f64,
    course: f64,
    count: f64,
}

impl SquaredErrors {
    fn add(&mut self, error: &AngleError) {
        self.roll += error.roll_deg.powi(2);
        self.pitch += error.pitch_deg.powi(2);
        self.heading += error.yaw_deg.powi(2);
        self.course += error.course_deg.powi(2);
        self.count += 1.0;
    }

    fn combined(self, other: Self) -> Self {
        Self {
            roll: self.roll + other.roll,
            pitch: self.pitch + other.pitch,
            heading: self.heading + other.heading,
            course: self.course + other.course,
            count: self.count + other.count,
        }
    }

    /// Returns the RMS roll error in degrees, or `None` if no sample was scored.
    pub fn roll_deg(&self) -> Option<f64> {
        self.rms(self.roll)
    }

    /// Returns the RMS pitch error in degrees, or `None` if no sample was scored.
    pub fn pitch_deg(&self) -> Option<f64> {
        self.rms(self.pitch)
    }

    /// Returns the RMS heading error of the stage in degrees, or `None` if no sample was scored.
    pub fn heading_deg(&self) -> Option<f64> {
        self.rms(self.heading)
    }

    /// Returns the RMS error in degrees of the course from the stage `track`, or `None` if no
    /// sample was scored.
    pub fn course_deg(&self) -> Option<f64> {
        self.rms(self.course)
    }

    fn rms(&self, sum: f64) -> Option<f64> {
        (self.count > 0.0).then(|| f64::sqrt(sum / self.count))
    }
}

/// Errors of a stage over one or more flights.
#[derive(Debug, Clone, Default)]
pub(crate) struct StageErrors {
    /// Plotted errors, each with its time in seconds. The course is that of the stage `track`,
    /// which computes it from the attitude of this stage.
    pub(crate) samples: Vec<(f64, AngleError)>,
    /// Errors while fixes were available.
    pub(crate) aided: SquaredErrors,
    /// Errors while no fixes were available.
    pub(crate) autonomous: SquaredErrors,
}

impl StageErrors {
    /// Adds the sums of `other`. The plotted samples of `self` are kept unchanged.
    pub(crate) fn combined(self, other: &Self) -> Self {
        let (aided, autonomous) = (self.aided.combined(other.aided), self.autonomous.combined(other.autonomous));
        Self { samples: self.samples, aided, autonomous }
    }

    /// Returns the errors of the whole flight.
    pub(crate) fn total(&self) -> SquaredErrors {
        self.aided.combined(self.autonomous)
    }
}

/// Runs all stages over one flight. Returns `None` if the scenario or a stage does not exist.
pub(crate) fn run_flight(coverage: GnssCoverage, seed: u64) -> Option<Vec<StageErrors>> {
    let text = format!("cruise?gnss={}&seed={seed}&duration_s={DURATION_S}", coverage.key());
    let scenario = Scenario::parse(&text).ok()?;
    let (mut gyro, mut accel) = (Gyro::from_name("mobius")?, Accelerometer::default());
    let mut fusers = STAGES.iter().map(|name| Fuser::from_name(name)).collect::<Option<Vec<_>>>()?;
    let mut courses = STAGES.iter().map(|_| Course::from_name("track")).collect::<Option<Vec<_>>>()?;
    let mut errors = vec![StageErrors::default(); STAGES.len()];
    let (mut previous_s, mut since_fix_s) = (0.0, f64::INFINITY);
    for (tick, (t_s, reading)) in scenario.readings().enumerate() {
        let dt_s = t_s - previous_s;
        previous_s = t_s;
        since_fix_s = if reading.fix.is_some() { 0.0 } else { since_fix_s + dt_s };
        let input = FuserInput {
            motion: Some(gyro.step(&RateSample { rate_rad_s: reading.rate_rad_s, dt_s, kind: scenario.rate_kind })),
            inclination: Some(accel.step(&reading.force_m_s2)),
            field_ut: None,
            fix: reading.fix,
            rest_credible: true,
            rate_credible: true,
        };
        let truth = reading.truth.attitude.angles();
        for ((fuser, course), errors) in fusers.iter_mut().zip(&mut courses).zip(&mut errors) {
            let fused = fuser.step(&input);
            let course_output = course.step(&CourseInput {
                attitude: fused.attitude,
                reference: fused.reference,
                heading_sd_rad: fused.heading_sd_rad,
                fix: reading.fix,
                dt_s,
            });
            let angles = fused.attitude.angles();
            let Some(error) = AngleError::between(angles, course_output.course_rad, truth) else { continue };
            if t_s >= scenario.scored_from_s {
                let sums = if since_fix_s > FIX_TIMEOUT_S { &mut errors.autonomous } else { &mut errors.aided };
                sums.add(&error);
            }
            if tick % PLOT_DECIMATION == 0 {
                errors.samples.push((t_s, error));
            }
        }
    }
    Some(errors)
}

/// Runs all stages over the flights of all seeds. The returned samples are those of the first seed.
///
/// `done` is called after each flight.
pub(crate) fn run_flights(coverage: GnssCoverage, mut done: impl FnMut()) -> Vec<StageErrors> {
    let mut all: Option<Vec<StageErrors>> = None;
    for seed in 1..=SEEDS {
        let errors = run_flight(coverage, seed).unwrap_or_else(|| vec![StageErrors::default(); STAGES.len()]);
        all = Some(match all {
            None => errors,
            Some(before) => before.into_iter().zip(&errors).map(|(before, next)| before.combined(next)).collect(),
        });
        done();
    }
    all.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the RMS roll and pitch errors, degrees.
    fn axes(sums: &SquaredErrors) -> [f64; 2] {
        [sums.roll_deg().unwrap(), sums.pitch_deg().unwrap()]
    }

    fn worse(sums: &SquaredErrors) -> f64 {
        axes(sums)[0].max(axes(sums)[1])
    }

    #[test]
    fn aided_printed_law_meets_paper_two_stages_beat_it() {
        let errors = run_flight(GnssCoverage::Always, 1).unwrap();
        for (name, errors) in STAGES.iter().zip(&errors) {
            println!(
                "{name}: {:.3?}, heading {:.2?}, course {:.2?}",
                axes(&errors.aided),
                errors.aided.heading_deg(),
                errors.aided.course_deg()
            );
        }
        let [printed, unified, pi, aided] = &errors[..] else { panic!("four stages") };
        assert!(axes(&printed.aided).iter().all(|deg| (0.1..0.5).contains(deg)), "{:?}", axes(&printed.aided));
        let differences =
            axes(&unified.aided).into_iter().zip(axes(&printed.aided)).map(|(one, other)| (one - other).abs());
        assert!(differences.fold(0.0, f64::max) < 1e-9, "P1 is the printed law");
        assert!(worse(&pi.aided) < 0.2 && worse(&aided.aided) < 0.1);
        // The expected course error is the course time constant times the gyro bias: 50 s · 0.05
        // °/s = 2.5°.
        assert!((2.0..3.0).contains(&printed.aided.course_deg().unwrap()));
    }

    #[test]
    fn unified_in_gaps_carries_autonomous_error() {
        let errors = run_flight(GnssCoverage::Gaps, 1).unwrap();
        for (name, errors) in STAGES.iter().zip(&errors) {
            println!("{name}: {:.3?} aided, {:.3?} in gaps", axes(&errors.aided), axes(&errors.autonomous));
        }
        let [printed, unified, pi, aided] = &errors[..] else { panic!("four stages") };
        let (unified, printed) = (worse(&unified.autonomous), worse(&printed.autonomous));
        assert!((2.0..5.0).contains(&unified) && unified > printed);
        assert!(worse(&pi.autonomous) < 0.3 && worse(&aided.autonomous) < 0.2);
    }

    #[test]
    fn fixed_laws_without_fixes_carry_gyro_bias() {
        let errors = run_flight(GnssCoverage::Never, 1).unwrap();
        for (name, errors) in STAGES.iter().zip(&errors) {
            println!("{name}: {:.3?}", axes(&errors.autonomous));
        }
        for errors in &errors[..3] {
            assert!((1.5..6.0).contains(&worse(&errors.autonomous)), "{:?}", axes(&errors.autonomous));
            assert_eq!(errors.aided.roll_deg(), None);
        }
    }
}
