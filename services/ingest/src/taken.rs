//! The topic `reading`: what ingest takes, as it came, so that a flight can be replayed.
//!
//! Input: readings in the order in which they are taken. Output: messages of which the same readings can be made again. Time: none. Failure: none;
//! a message that brings no fix, say, has NaN for it.

use attitude::gnss::Fix;
use bus::{BusError, Publisher};
use messages::TakenReading;
use runtime::ServiceConfig;

use crate::{
    conditioner::Conditioner,
    source::{Reading, ReceiverFix, Truth},
};

/// Publishes each reading that is taken.
pub(crate) struct TakenReadings {
    publisher: Publisher<TakenReading>,
    incarnation: u32,
    number: u64,
    /// Readings of the ticks before this one were published by an earlier incarnation.
    first_tick: u64,
}

impl TakenReadings {
    pub(crate) fn new(publisher: Publisher<TakenReading>, config: &ServiceConfig, first_tick: u64) -> Self {
        Self { publisher, incarnation: config.incarnation, number: 0, first_tick }
    }

    /// Publishes what the conditioner is given next.
    pub(crate) fn publish(&mut self, reading: &Reading, conditioner: &Conditioner) -> Result<(), BusError> {
        let number = self.number;
        self.number += 1;
        if conditioner.ticks() < self.first_tick {
            return Ok(());
        }
        let (tick, offset_ns) = (conditioner.ticks(), conditioner.offset_ns());
        let incarnation = self.incarnation;
        self.publisher.send(&TakenReading { number, tick, offset_ns, incarnation, ..reading.into() })
    }
}

impl From<&Reading> for TakenReading {
    fn from(reading: &Reading) -> Self {
        let Reading { t_ns, rate_rad_s, force_m_s2, field_ut, fix, reference } = *reading;
        let brings = |part: u32, is_there: bool| if is_there { part } else { 0 };
        let told = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let (longitude_rad, altitude_m) = (fix.and_then(|fix| fix.longitude_rad), fix.and_then(|fix| fix.altitude_m));
        let fix = fix.map(|received| received.fix);
        Self {
            t_sensor_ns: t_ns,
            rate_rad_s,
            force_m_s2,
            field_ut: field_ut.unwrap_or([f64::NAN; 3]),
            velocity_m_s: fix.map_or([f64::NAN; 3], |fix| fix.velocity_m_s.into()),
            velocity_sd_m_s: told(fix.and_then(|fix| fix.sd_m_s)),
            age_s: told(fix.and_then(|fix| fix.age_s)),
            latitude_rad: told(fix.and_then(|fix| fix.latitude_rad)),
            longitude_rad: told(longitude_rad),
            altitude_m: told(altitude_m),
            quaternion: reference.map_or([f64::NAN; 4], |truth| truth.quaternion),
            brings: brings(Self::FIELD, field_ut.is_some())
                | brings(Self::FIX, fix.is_some())
                | brings(Self::REFERENCE, reference.is_some())
                | brings(Self::SCORED, reference.is_some_and(|truth| truth.scored)),
            ..bytemuck::Zeroable::zeroed()
        }
    }
}

impl From<&TakenReading> for Reading {
    fn from(taken: &TakenReading) -> Self {
        let brings = |part: u32| taken.brings & part != 0;
        let told = |value: f64| Some(value).filter(|value| !value.is_nan());
        let fix = ReceiverFix {
            fix: Fix {
                velocity_m_s: taken.velocity_m_s.into(),
                sd_m_s: told(taken.velocity_sd_m_s),
                age_s: told(taken.age_s),
                latitude_rad: told(taken.latitude_rad),
            },
            longitude_rad: told(taken.longitude_rad),
            altitude_m: told(taken.altitude_m),
        };
        let truth = Truth { quaternion: taken.quaternion, scored: brings(TakenReading::SCORED) };
        Self {
            t_ns: taken.t_sensor_ns,
            rate_rad_s: taken.rate_rad_s,
            force_m_s2: taken.force_m_s2,
            field_ut: brings(TakenReading::FIELD).then_some(taken.field_ut),
            fix: brings(TakenReading::FIX).then_some(fix),
            reference: brings(TakenReading::REFERENCE).then_some(truth),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    /// Bits, so that NaN is equal to itself.
    fn bits(reading: &Reading) -> Vec<u8> {
        bytemuck::bytes_of(&TakenReading::from(reading)).to_vec()
    }

    #[test]
    fn a_reading_comes_back_as_it_was_whatever_is_missing() {
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
                let back = Reading::from(&TakenReading::from(&reading));
                assert_eq!(bits(&back), bits(&reading));
                let parts = |reading: &Reading| {
                    let Reading { field_ut, fix, reference, .. } = *reading;
                    let told = fix.map(|ReceiverFix { fix, longitude_rad, altitude_m }| {
                        [fix.sd_m_s, fix.age_s, fix.latitude_rad, longitude_rad, altitude_m]
                    });
                    (field_ut.is_some(), told, reference)
                };
                assert_eq!(parts(&back), parts(&reading));
            }
        }
    }
}
