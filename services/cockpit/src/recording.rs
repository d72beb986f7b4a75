//! A recording, thinned out once when it is opened: as many pictures as a page needs, all of one length in time.
//!
//! Input: messages of the topics with the source's time, in the order in which they were published. Output: pictures by their number. Memory:
//! bounded, whatever the recording's length.

use graph::Topic;
use wire::{
    cockpit,
    command::ControlMessage,
    v1::{Standing, standing::State},
};

use crate::{SNAPSHOT_INTERVAL, picture::Decimator};

/// Pictures of a recording at most: half an hour at the rate of a live picture, and a longer one at a lower.
const MAX_PICTURES: u64 = 60_000;
/// Pictures in an answer at most, and their bytes.
const MAX_ANSWER: usize = 4096;
const ANSWER_BYTES: usize = 8 << 20;

/// A recording.
#[derive(Debug)]
pub struct Recording {
    /// Encoded, in the order of time.
    pictures: Vec<Vec<u8>>,
    name: String,
    rate_hz: f64,
    t_first_ns: i64,
    t_last_ns: i64,
}

/// A recording that is being read.
#[derive(Debug)]
pub struct Reading {
    recording: Recording,
    interval_ns: i64,
    thinner: Decimator,
}

impl Recording {
    /// Begins to read one whose source's time goes from `t_first_ns` to `t_last_ns`.
    pub fn reading(name: &str, rate_hz: f64, t_first_ns: i64, t_last_ns: i64) -> Reading {
        let t_last_ns = t_last_ns.max(t_first_ns.saturating_add(1));
        let least_ns = t_last_ns.abs_diff(t_first_ns).div_ceil(MAX_PICTURES).cast_signed();
        let interval_ns = (SNAPSHOT_INTERVAL.as_nanos() as i64).max(least_ns);
        let recording = Self { pictures: Vec::new(), name: name.into(), rate_hz, t_first_ns, t_last_ns };
        Reading { recording, interval_ns, thinner: Decimator::default() }
    }

    /// Encoded pictures from a number on.
    pub(crate) fn pictures(&self, from: usize, count: usize) -> Vec<u8> {
        let asked = self.pictures.iter().skip(from).take(count.min(MAX_ANSWER));
        let mut room = ANSWER_BYTES;
        let fits = asked.take_while(|picture| {
            let fits = room >= picture.len();
            room = room.saturating_sub(picture.len());
            fits
        });
        cockpit::encode_pictures(fits.map(Vec::as_slice))
    }

    /// What a page is told of it.
    pub fn standing(&self) -> Standing {
        Standing {
            state: State::Recording.into(),
            system: self.name.clone(),
            source: "recording".into(),
            rate_hz: self.rate_hz,
            version: env!("CARGO_PKG_VERSION").into(),
            t_first_ns: self.t_first_ns,
            t_last_ns: self.t_last_ns,
            pictures: self.pictures.len() as u64,
            ..Standing::default()
        }
    }
}

impl Reading {
    /// Takes a message; one whose time is before the last one's belongs to the same picture as that.
    pub fn take(&mut self, t_ns: i64, topic: Topic, bytes: &[u8]) {
        self.close_until(t_ns.min(self.recording.t_last_ns));
        self.thinner.take(topic, bytes);
    }

    /// The recording.
    pub fn finish(mut self) -> Recording {
        self.close_until(self.recording.t_last_ns);
        self.close();
        self.recording
    }

    fn close_until(&mut self, t_ns: i64) {
        while self.end_ns() <= t_ns {
            self.close();
        }
    }

    /// The end of the picture that is being made.
    fn end_ns(&self) -> i64 {
        let ended = self.recording.pictures.len() as i64 + 1;
        self.recording.t_first_ns.saturating_add(ended.saturating_mul(self.interval_ns))
    }

    fn close(&mut self) {
        let made_ns = self.end_ns().max(0).cast_unsigned();
        self.recording.pictures.push(self.thinner.picture(made_ns).to_bytes());
    }
}

#[cfg(test)]
mod tests {
    use messages::AttitudeOutput;
    use wire::v1::Picture;

    use super::*;

    fn at(t_ns: i64) -> AttitudeOutput {
        let mut attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
        attitude.quaternion = [1.0, 0.0, 0.0, 0.0];
        attitude.header.t_end_ns = t_ns;
        attitude
    }

    #[test]
    fn a_long_recording_has_no_more_pictures_than_there_is_room_for_and_each_its_time() {
        const HOURS_4_NS: i64 = 4 * 3_600_000_000_000;
        let mut reading = Recording::reading("long", 1.0, 0, HOURS_4_NS);
        for t_ns in (0..=HOURS_4_NS).step_by(1_000_000_000) {
            reading.take(t_ns, Topic::Attitude, bytemuck::bytes_of(&at(t_ns)));
        }
        let recording = reading.finish();
        assert!(recording.pictures.len() as u64 <= MAX_PICTURES + 1, "{}", recording.pictures.len());
        let middle = Picture::from_bytes(&recording.pictures[MAX_PICTURES as usize / 2]).unwrap();
        let t_ns = middle.attitude.map_or(0, |attitude| attitude.header.unwrap_or_default().t_end_ns);
        assert!((t_ns - HOURS_4_NS / 2).abs() <= HOURS_4_NS / MAX_PICTURES as i64 + 1_000_000_000 || t_ns == 0);
    }

    #[test]
    fn pictures_are_given_by_their_numbers_and_nothing_beyond_the_end() {
        let mut reading = Recording::reading("short", 100.0, 0, 1_000_000_000);
        (0..100).for_each(|i| reading.take(i * 10_000_000, Topic::Attitude, bytemuck::bytes_of(&at(i))));
        let recording = reading.finish();
        assert_eq!(recording.standing().pictures, 31, "one for each 33 ms of a second");
        assert!(recording.pictures(0, usize::MAX).len() > recording.pictures(30, 10).len());
        assert_eq!(recording.pictures(31, 1), Vec::<u8>::new());
    }
}
