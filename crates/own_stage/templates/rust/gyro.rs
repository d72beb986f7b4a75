//! The stage `@name@` for the slot gyro: how the body turned over each interval, from its rate.
//!
//! Input: the rate and the length of its interval. Output: the turn, and the attitude without any correction. Time: the interval; one that
//! is no time is none. Failure: a rate that is not a number is that of the sample before.

use attitude::{
    Vector3,
    gyro::{GyroStage, Motion, RateKind, RateSample},
    point::Chart,
    stage::{RestoreError, Stage},
    state::Attitude,
    turn::Turn,
};

/// The name by which it is chosen.
pub const NAME: &str = "@name@";

/// Faster than any gyro's range, rad/s; what is beyond it is taken for this.
const RATE_MAX_RAD_S: f64 = 1000.0;

/// Turns by the mean rate of the interval: exact while the rate is constant.
#[derive(Debug, Clone, Default)]
pub struct @Class@ {
    attitude: Attitude,
    before_rad_s: Vector3<f64>,
    started: bool,
}

impl GyroStage for @Class@ {
    fn align(&mut self, attitude: Attitude) {
        self.attitude = attitude;
    }
}

impl Stage for @Class@ {
    type Input = RateSample;
    type Output = Motion;
    type Common = Attitude;

    fn name(&self) -> &'static str {
        NAME
    }

    fn step(&mut self, sample: &RateSample) -> Motion {
        let in_time = sample.dt_s >= 0.0 && sample.dt_s.is_finite();
        let dt_s = if in_time { sample.dt_s } else { 0.0 };
        let number = sample.rate_rad_s.iter().all(|x| x.is_finite());
        let rate_rad_s = if number { sample.rate_rad_s } else { self.before_rad_s };
        let after_rad_s = rate_rad_s.map(|x| x.clamp(-RATE_MAX_RAD_S, RATE_MAX_RAD_S));
        let at_end = self.started && sample.kind == RateKind::Instant;
        let mean_rad_s = if at_end { (self.before_rad_s + after_rad_s) * 0.5 } else { after_rad_s };
        let turn = Turn::of_rotation_vector(mean_rad_s * dt_s);
        self.attitude = self.attitude.turned(turn).attitude;
        (self.before_rad_s, self.started) = (after_rad_s, true);
        Motion { attitude: self.attitude, turn, rate_rad_s: mean_rad_s, dt_s }
    }

    fn visit_state(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let mut inverted = f64::from(self.attitude.up.chart as u8);
        let mut started = f64::from(u8::from(self.started));
        visit(&mut self.attitude.up.w.re);
        visit(&mut self.attitude.up.w.im);
        visit(&mut inverted);
        visit(&mut self.attitude.z_rad);
        visit(&mut started);
        self.before_rad_s.iter_mut().for_each(visit);
        self.attitude.up.chart = if inverted > 0.5 { Chart::Inverted } else { Chart::Upright };
        self.started = started > 0.5;
    }

    fn flaw(&self) -> Option<&'static str> {
        let beyond = self.before_rad_s.amax() > RATE_MAX_RAD_S;
        flaw(self.attitude).or(beyond.then_some("a rate that no gyro gives"))
    }

    fn common(&self) -> Attitude {
        self.attitude
    }

    fn adopt(&mut self, common: &Attitude) -> Result<(), RestoreError> {
        flaw(*common).map_or(Ok(()), |flaw| Err(RestoreError::Flaw { flaw }))?;
        self.attitude = *common;
        Ok(())
    }
}

/// What is wrong with an attitude; one that is not a number is inside nothing.
fn flaw(attitude: Attitude) -> Option<&'static str> {
    let inside = attitude.up.w.norm_sqr() <= 2.0 && attitude.z_rad.abs() <= 4.0;
    (!inside).then_some("an attitude outside its chart")
}
