//! Where gravity points: a body that is always upside down is mounted, named or signed so.

use attitude::Vector3;

use crate::finding::{self, Finding};

/// What turns faster is not asked for its attitude, rad/s: in a roll or a loop every vehicle is upside down.
const RATE_MAX_RAD_S: f64 = 1.0;
/// Upside down, the cosine of the angle between force and our up axis is below this: 120°, farther than a body on its side leans.
const DOWN: f64 = -0.5;
/// How far |f| may be from its usual value to be taken for gravity: a turn of 25° bank.
const GRAVITY_SHARE: f64 = 0.1;
/// Share of each sample in the usual |f|: a second at 100 Hz, whatever the unit.
const USUAL_SHARE: f64 = 0.01;
/// Time at which this could be asked that a finding needs, s: longer than aerobatics hang upside down.
const SECONDS_MIN: f64 = 4.0;
/// The share of it that must be upside down: one that is turned over in the hand is so for a part of it.
const SHARE: f64 = 0.9;
/// Samples of the field that tell something: noise of one is up to 45°.
const FIELDS_MIN: u64 = 10;

/// How long it is upside down.
#[derive(Debug, Clone, Default)]
pub(crate) struct Uprightness {
    asked_s: f64,
    down_s: f64,
    /// |f|, slowly.
    usual: Option<f64>,
    force: Vector3<f64>,
    newest: Option<Vector3<f64>>,
    fields: u64,
    /// Sum of the cosines of the angles between force and field.
    along: f64,
}

impl Uprightness {
    pub(crate) fn take(&mut self, dt_s: f64, rate_rad_s: [f64; 3], force: [f64; 3]) {
        self.newest = None;
        let force = Vector3::from(force);
        let size = force.norm();
        let usual = self.usual.get_or_insert(size);
        *usual += (size - *usual) * USUAL_SHARE;
        let is_gravity = (size - *usual).abs() < GRAVITY_SHARE * *usual;
        if !is_gravity || !(0.0..1.0).contains(&dt_s) || Vector3::from(rate_rad_s).norm() > RATE_MAX_RAD_S {
            return;
        }
        let Some(up) = force.try_normalize(f64::MIN_POSITIVE) else { return };
        self.asked_s += dt_s;
        self.down_s += if up.z < DOWN { dt_s } else { 0.0 };
        self.force += force * dt_s;
        self.newest = Some(up);
    }

    pub(crate) fn field(&mut self, field_ut: [f64; 3]) {
        let Some((up, field)) = self.newest.zip(Vector3::from(field_ut).try_normalize(1e-9)) else { return };
        self.fields += 1;
        self.along += up.dot(&field);
    }

    pub(crate) fn finding(&self) -> Option<Finding> {
        if self.asked_s < SECONDS_MIN || self.down_s < SHARE * self.asked_s {
            return None;
        }
        let along = (self.fields >= FIELDS_MIN).then(|| self.along / self.fields as f64);
        Some(finding::upside_down((self.force / self.asked_s).into(), along))
    }
}
