//! Aircraft in cruise at about 50 m/s: turns of 2 to 3 °/s that last 20 to 60 s, with pauses of 60
//! to 180 s.
//!
//! Airspeed V = 50 + 8 sin(2πt/240) + 2 sin(2πt/37) m/s. Roll = atan(V H'/g) + 1° sin(2πt/7.3),
//! where the first term is the bank of a coordinated turn with the course rate H'. Pitch = 2° + 3°
//! sin(2πt/55) + 0.7° sin(2πt/5.1). The flight is level. The specific force is f = A (a + g), with
//! the acceleration a, gravity g pointing up, and the matrix A from reference to body axes. The
//! seed determines the phases and the turns, including their directions.
//!
//! Rates are central differences of the attitude, and accelerations are central differences of the
//! velocity. The hard flight adds wind, gusts and side slip, which change the velocity over ground.

use core::f64::consts::TAU;

use attitude::{GRAVITY_M_S2, Vector3, angles::Angles, rotation::Rotation, state::Attitude};

use crate::{
    random::{RandomStream, StreamId},
    truth::Truth,
};

/// Time constant of the logistic transition at the start and end of a turn, s.
const EDGE_TIME_CONSTANT_S: f64 = 1.5;
/// Half the step of the central differences, s.
const HALF_STEP_S: f64 = 1e-3;
/// Wind speed of the hard flight, m/s.
const WIND_M_S: f64 = 10.0;
/// RMS gust velocity of the hard flight on each horizontal axis, m/s.
const GUST_RMS_M_S: f64 = 1.5;
/// Periods of the gusts, s. Each period contributes the same power.
const GUST_PERIODS_S: [f64; 4] = [7.0, 17.0, 41.0, 97.0];
/// Amplitude of the side slip in the hard flight, rad (3°).
const SLIP_RAD: f64 = 3.0 * core::f64::consts::PI / 180.0;
/// Period of the side slip, s.
const SLIP_PERIOD_S: f64 = 31.0;

/// Parameters of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flight {
    /// Seed of the phases, the turns, the wind and the gusts.
    pub seed: u64,
    /// `true` for a flight with wind, gusts and side slip.
    pub hard: bool,
}

#[derive(Debug, Clone, Copy)]
struct Turn {
    start_s: f64,
    end_s: f64,
    /// Course rate, rad/s, clockwise positive.
    rate_rad_s: f64,
    /// Course before the turn, rad, clockwise from north.
    course_rad: f64,
}

/// Course and airspeed at a given time.
struct FlightState {
    t_s: f64,
    course_rad: f64,
    course_rate_rad_s: f64,
    speed_m_s: f64,
}

#[derive(Debug, Clone)]
struct AirMotion {
    wind_m_s: Vector3<f64>,
    gust_phases: [[f64; 2]; GUST_PERIODS_S.len()],
    slip_phase: f64,
}

/// Flight with the turns generated so far.
#[derive(Debug, Clone)]
pub(crate) struct FlightPlan {
    turns: Vec<Turn>,
    rng: RandomStream,
    phases: [f64; 5],
    air: Option<AirMotion>,
}

impl FlightPlan {
    pub(crate) fn new(flight: Flight) -> Self {
        let mut rng = RandomStream::new(flight.seed, StreamId::Flight);
        let phases = [(); 5].map(|()| rng.phase());
        let course_rad = rng.phase();
        let before = Turn { start_s: 0.0, end_s: 0.0, rate_rad_s: 0.0, course_rad };
        let air = flight.hard.then(|| AirMotion::new(flight.seed));
        Self { turns: vec![before], rng, phases, air }
    }

    pub(crate) fn at(&mut self, t_s: f64) -> Truth {
        let (before_s, after_s) = (t_s - HALF_STEP_S, t_s + HALF_STEP_S);
        let [before, now, after] = [before_s, t_s, after_s].map(|t_s| self.state(t_s));
        let attitude = self.attitude(&now);
        let step_s = 2.0 * HALF_STEP_S;
        let rotation = Rotation::between(self.attitude(&before), self.attitude(&after)).quaternion();
        let angle = 2.0 * libm::asin(rotation.imag().norm());
        let rate_rad_s = rotation.imag().try_normalize(0.0).unwrap_or_default()
            * (angle / step_s * if rotation.w < 0.0 { -1.0 } else { 1.0 });
        let acceleration_m_s2 = (self.ground_velocity_m_s(&after) - self.ground_velocity_m_s(&before)) / step_s;
        let force_m_s2 = attitude.matrix() * (acceleration_m_s2 + Vector3::z() * GRAVITY_M_S2);
        Truth { attitude, rate_rad_s, force_m_s2 }
    }

    /// Returns the velocity over ground, m/s, east, north, up.
    pub(crate) fn velocity_m_s(&mut self, t_s: f64) -> Vector3<f64> {
        let state = self.state(t_s);
        self.ground_velocity_m_s(&state)
    }

    fn state(&mut self, t_s: f64) -> FlightState {
        let (course_rad, course_rate_rad_s) = self.course(t_s);
        FlightState { t_s, course_rad, course_rate_rad_s, speed_m_s: self.speed_m_s(t_s) }
    }

    fn ground_velocity_m_s(&self, state: &FlightState) -> Vector3<f64> {
        let FlightState { t_s, course_rad, speed_m_s, .. } = *state;
        let slip_rad = self.air.as_ref().map_or(0.0, |air| air.slip_rad(t_s));
        let (sin, cos) = libm::sincos(course_rad + slip_rad);
        let airspeed_m_s = Vector3::new(sin, cos, 0.0) * speed_m_s;
        airspeed_m_s + self.air.as_ref().map_or(Vector3::zeros(), |air| air.velocity_m_s(t_s))
    }

    fn attitude(&self, state: &FlightState) -> Attitude {
        let FlightState { t_s, course_rad, course_rate_rad_s, speed_m_s } = *state;
        let [_, _, roll_phase, slow_phase, fast_phase] = self.phases;
        let oscillation = |period_s: f64, phase: f64| libm::sin(TAU * t_s / period_s + phase);
        let bank_rad = libm::atan(speed_m_s * course_rate_rad_s / GRAVITY_M_S2);
        Attitude::from_angles(Angles {
            yaw_rad: -course_rad,
            pitch_rad: (2.0 + 3.0 * oscillation(55.0, slow_phase) + 0.7 * oscillation(5.1, fast_phase)).to_radians(),
            roll_rad: bank_rad + oscillation(7.3, roll_phase).to_radians(),
        })
    }

    fn speed_m_s(&self, t_s: f64) -> f64 {
        50.0 + 8.0 * libm::sin(TAU * t_s / 240.0 + self.phases[0]) + 2.0 * libm::sin(TAU * t_s / 37.0 + self.phases[1])
    }

    /// Returns the course in rad and its rate in rad/s, both clockwise positive.
    fn course(&mut self, t_s: f64) -> (f64, f64) {
        // Beyond 40 time constants the logistic function equals its limit in double precision.
        let edge_duration_s = 40.0 * EDGE_TIME_CONSTANT_S;
        self.extend_to(t_s + edge_duration_s);
        let first = self.turns.partition_point(|turn| turn.end_s + edge_duration_s < t_s).min(self.turns.len() - 1);
        let started = self.turns[first..].iter().take_while(|turn| turn.start_s - edge_duration_s < t_s);
        started.fold((self.turns[first].course_rad, 0.0), |(course_rad, rate_rad_s), turn| {
            let [start, end] = [turn.start_s, turn.end_s].map(|edge_s| logistic((t_s - edge_s) / EDGE_TIME_CONSTANT_S));
            let ((start_share, start_integral), (end_share, end_integral)) = (start, end);
            let (share, turned_s) = (start_share - end_share, EDGE_TIME_CONSTANT_S * (start_integral - end_integral));
            (course_rad + turn.rate_rad_s * turned_s, rate_rad_s + turn.rate_rad_s * share)
        })
    }

    /// Generates turns until the last generated turn ends after `t_s`.
    fn extend_to(&mut self, t_s: f64) {
        while let Some(last) = self.turns.last().copied().filter(|last| last.end_s <= t_s) {
            let start_s = last.end_s + self.rng.uniform(60.0, 180.0);
            let end_s = start_s + self.rng.uniform(20.0, 60.0);
            let rate_rad_s = self.rng.sign() * self.rng.uniform(2.0, 3.0).to_radians();
            let course_rad = last.course_rad + last.rate_rad_s * (last.end_s - last.start_s);
            self.turns.push(Turn { start_s, end_s, rate_rad_s, course_rad });
        }
    }
}

impl AirMotion {
    fn new(seed: u64) -> Self {
        let mut noise = RandomStream::new(seed, StreamId::Air);
        let (sin, cos) = libm::sincos(noise.phase());
        let gust_phases = [(); GUST_PERIODS_S.len()].map(|()| [noise.phase(), noise.phase()]);
        Self { wind_m_s: Vector3::new(sin, cos, 0.0) * WIND_M_S, gust_phases, slip_phase: noise.phase() }
    }

    fn velocity_m_s(&self, t_s: f64) -> Vector3<f64> {
        // A sine of amplitude a has the power a²/2.
        let amplitude_m_s = GUST_RMS_M_S * libm::sqrt(2.0 / GUST_PERIODS_S.len() as f64);
        GUST_PERIODS_S.iter().zip(self.gust_phases).fold(self.wind_m_s, |sum, (period_s, [east, north])| {
            let gust = |phase: f64| amplitude_m_s * libm::sin(TAU * t_s / period_s + phase);
            sum + Vector3::new(gust(east), gust(north), 0.0)
        })
    }

    fn slip_rad(&self, t_s: f64) -> f64 {
        SLIP_RAD * libm::sin(TAU * t_s / SLIP_PERIOD_S + self.slip_phase)
    }
}

/// Returns the logistic function at `x` and its integral, ln(1 + eˣ).
fn logistic(x: f64) -> (f64, f64) {
    // For larger x the logistic function and its integral equal 1 and x in double precision.
    if x > 40.0 {
        return (1.0, x);
    }
    let decaying = libm::exp(-libm::fabs(x));
    let exponential = if x < 0.0 { libm::exp(-x) } else { decaying };
    (1.0 / (1.0 + exponential), x.max(0.0) + libm::log1p(decaying))
}
