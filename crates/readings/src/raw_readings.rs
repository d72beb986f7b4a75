//! Converts raw readings to messages of the topic `reading`, and back.
//!
//! Missing values of a message are NaN.

use attitude::gnss::{Fix, ReceiverFix};
use messages::TakenReading;

use crate::source::{Reading, Truth};

impl From<&Reading> for TakenReading {
    fn from(reading: &Reading) -> Self {
        let Reading { t_ns, rate_rad_s, force_m_s2, field_ut, fix, reference } = *reading;
        let bits_if = |part: u32, is_present: bool| if is_present { part } else { 0 };
        let or_nan = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let (longitude_rad, altitude_m) = (fix.and_then(|fix| fix.longitude_rad), fix.and_then(|fix| fix.altitude_m));
        let fix = fix.map(|received| received.fix);
        Self {
            t_sensor_ns: t_ns,
            rate_rad_s,
            force_m_s2,
            field_ut: field_ut.unwrap_or([f64::NAN; 3]),
            velocity_m_s: fix.map_or([f64::NAN; 3], |fix| fix.velocity_m_s.into()),
            velocity_sd_m_s: or_nan(fix.and_then(|fix| fix.sd_m_s)),
            age_s: or_nan(fix.and_then(|fix| fix.age_s)),
            latitude_rad: or_nan(fix.and_then(|fix| fix.latitude_rad)),
            longitude_rad: or_nan(longitude_rad),
            altitude_m: or_nan(altitude_m),
            quaternion: reference.map_or([f64::NAN; 4], |truth| truth.quaternion),
            present: bits_if(Self::FIELD, field_ut.is_some())
                | bits_if(Self::FIX, fix.is_some())
                | bits_if(Self::REFERENCE, reference.is_some())
                | bits_if(Self::SCORED, reference.is_some_and(|truth| truth.scored)),
            ..bytemuck::Zeroable::zeroed()
        }
    }
}

impl From<&TakenReading> for Reading {
    fn from(raw: &TakenReading) -> Self {
        let has = |part: u32| raw.present & part != 0;
        let not_nan = |value: f64| Some(value).filter(|value| !value.is_nan());
        let fix = ReceiverFix {
            fix: Fix {
                velocity_m_s: raw.velocity_m_s.into(),
                sd_m_s: not_nan(raw.velocity_sd_m_s),
                age_s: not_nan(raw.age_s),
                latitude_rad: not_nan(raw.latitude_rad),
            },
            longitude_rad: not_nan(raw.longitude_rad),
            altitude_m: not_nan(raw.altitude_m),
        };
        let truth = Truth { quaternion: raw.quaternion, scored: has(TakenReading::SCORED) };
        Self {
            t_ns: raw.t_sensor_ns,
            rate_rad_s: raw.rate_rad_s,
            force_m_s2: raw.force_m_s2,
            field_ut: has(TakenReading::FIELD).then_some(raw.field_ut),
            fix: has(TakenReading::FIX).then_some(fix),
            reference: has(TakenReading::REFERENCE).then_some(truth),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the bytes of the message, so that NaN compares equal to itself.
    fn bits(reading: &Reading) -> Vec<u8> {
        bytemuck::bytes_of(&TakenReading::from(reading)).to_vec()
    }

    #[test]
    fn raw_reading_round_trips_with_missing_parts() {
        let fix = |sd_m_s, age_s, latitude_rad| ReceiverFix {
            fix: Fix { velocity_m_s: [1.0, -2.0, f64::NAN].into(), sd_m_s, age_s, latitude_rad },
            longitude_rad: latitude_rad.map(|rad: f64| -rad),
            altitude_m: age_s,
        };
        let fixes = [None, Some(fix(None, None, Some(0.8))), Some(fix(Some(0.1), Some(f64::INFINITY), None))];
        let fields = [None, Some([1.0, f64::NAN, 3.0]), Some([f64::NAN; 3])];
        let truth = |scored| Truth { quaternion: [0.5; 4], scored };
        for (fix, field_ut) in fixes.iter().flat_map(|fix| fields.map(|field_ut| (*fix, field_ut))) {
            for reference in [None, Some(truth(false)), Some(truth(true))] {
                let (rate_rad_s, force_m_s2) = ([0.1, f64::NAN, 1e300], [f64::NEG_INFINITY, 0.0, 9.8]);
                let reading = Reading { t_ns: -7, rate_rad_s, force_m_s2, field_ut, fix, reference };
                let converted = Reading::from(&TakenReading::from(&reading));
                assert_eq!(bits(&converted), bits(&reading));
                let parts = |reading: &Reading| {
                    let Reading { field_ut, fix, reference, .. } = *reading;
                    let optional = fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| {
                        [fix.sd_m_s, fix.age_s, fix.latitude_rad, longitude_rad, altitude_m]
                    });
                    (field_ut.is_some(), optional, reference)
                };
                assert_eq!(parts(&converted), parts(&reading));
            }
        }
    }
}
