//! Reduces messages to what the page shows, which is the newest message of each topic and the range
//! of each quantity.
//!
//! Input: every message. Output: a snapshot of the messages since the previous snapshot. Memory:
//! bounded. If there are too many events, the newest are kept. Failure: malformed messages and
//! non-finite values are ignored.

use std::time::Duration;

use attitude::Quaternion;
use graph::Topic;
use messages::{
    AccelPoint, AttitudeOutput, Difference, FusedState, GnssFix, GyroStep, Health, ImuSample, MagSample, Reference,
    SystemEvent,
};
use wire::{
    Payload,
    v1::{Extremes, Quantity, Snapshot},
};

/// Interval between snapshots.
pub const SNAPSHOT_INTERVAL: Duration = Duration::from_millis(33);
/// Maximum number of events in a snapshot.
pub const MAX_EVENTS: usize = 256;
/// Number of reference attitudes kept for comparison with attitudes of the same tick.
const MAX_REFERENCES: usize = 4096;
/// Maximum number of attitudes per snapshot that are compared with reference attitudes.
const MAX_ATTITUDES: usize = 4096;
/// Length of an array indexed by [`Quantity`]. The array has an element for the unspecified
/// quantity.
const QUANTITY_COUNT: usize = Quantity::LatencyS as usize + 1;

/// Collector that reduces messages to snapshots.
#[derive(Debug)]
pub struct Decimator {
    snapshots: u64,
    snapshot: Snapshot,
    extremes: [Option<[f64; 2]>; QUANTITY_COUNT],
    /// Reference attitudes, indexed by their ticks modulo [`MAX_REFERENCES`].
    references: Vec<Option<Reference>>,
    /// Ticks and quaternions of the attitudes since the last snapshot.
    attitudes: Vec<(u64, [f64; 4])>,
    /// Attitudes of the last snapshot that had no reference yet.
    unmatched: Vec<(u64, [f64; 4])>,
}

impl Default for Decimator {
    fn default() -> Self {
        Self {
            snapshots: 0,
            snapshot: Snapshot::default(),
            extremes: [None; QUANTITY_COUNT],
            references: vec![None; MAX_REFERENCES],
            attitudes: Vec::new(),
            unmatched: Vec::new(),
        }
    }
}

impl Decimator {
    /// Returns the number of snapshots taken so far.
    pub fn snapshots(&self) -> u64 {
        self.snapshots
    }

    /// Adds a message of `topic`. Malformed messages are ignored.
    pub fn push(&mut self, topic: Topic, bytes: &[u8]) {
        match topic {
            Topic::Imu => self.push_imu(bytes),
            Topic::Mag => self.push_mag(bytes),
            Topic::Gnss => store::<GnssFix>(bytes, &mut self.snapshot.gnss),
            Topic::Gyro => store::<GyroStep>(bytes, &mut self.snapshot.gyro),
            Topic::Accel => store::<AccelPoint>(bytes, &mut self.snapshot.accel),
            Topic::Fused => self.push_fused(bytes),
            Topic::Attitude => self.push_attitude(bytes),
            Topic::Reference => {
                if let Some(reference) = read::<Reference>(bytes) {
                    self.references[reference.tick as usize % MAX_REFERENCES] = Some(reference);
                }
            }
            Topic::Difference => {
                if let Some(difference) = read::<Difference>(bytes) {
                    let all = &mut self.snapshot.differences;
                    upsert(all, difference.to_proto(), |one, new| one.service == new.service);
                }
            }
            Topic::Health => {
                if let Some(health) = read::<Health>(bytes) {
                    let same = |one: &wire::v1::Health, new: &wire::v1::Health| {
                        (one.service, one.incarnation) == (new.service, new.incarnation)
                    };
                    upsert(&mut self.snapshot.health, health.to_proto(), same);
                }
            }
            Topic::Event => {
                if let Some(event) = read::<SystemEvent>(bytes) {
                    let events = &mut self.snapshot.events;
                    if events.len() >= MAX_EVENTS {
                        events.remove(0);
                    }
                    events.push(event.to_proto());
                }
            }
            // These topics are not shown on the page.
            Topic::Sensor | Topic::Receiver | Topic::Reading | Topic::Credit | Topic::Checkpoint | Topic::Control => {}
        }
    }

    /// Returns a snapshot of the messages since the previous call and starts the next one.
    ///
    /// `now_ns` is the time on CLOCK_MONOTONIC.
    pub fn take_snapshot(&mut self, now_ns: u64) -> Snapshot {
        self.compare_with_references();
        let mut snapshot = std::mem::take(&mut self.snapshot);
        (snapshot.number, snapshot.t_created_ns) = (self.snapshots, now_ns);
        snapshot.extremes = std::mem::replace(&mut self.extremes, [None; QUANTITY_COUNT])
            .into_iter()
            .zip(0..)
            .filter_map(|(range, quantity)| range.map(|[min, max]| Extremes { quantity, min, max }))
            .collect();
        self.snapshots += 1;
        snapshot
    }

    /// Computes the errors of the collected attitudes that have a reference of the same tick, and
    /// of those of the last snapshot that have received theirs since.
    ///
    /// Called once per snapshot instead of once per attitude, because a reference may arrive after
    /// its attitude.
    fn compare_with_references(&mut self) {
        for (tick, quaternion) in std::mem::take(&mut self.unmatched) {
            if let Some(reference) = self.reference(tick) {
                self.extend_range(Quantity::ErrorRad, angle_rad(quaternion, reference.quaternion));
            }
        }
        let attitudes = std::mem::take(&mut self.attitudes);
        self.snapshot.attitudes = attitudes.len() as u64;
        for (tick, quaternion) in attitudes {
            if let Some(reference) = self.reference(tick) {
                self.extend_range(Quantity::ErrorRad, angle_rad(quaternion, reference.quaternion));
                self.snapshot.reference = Some(reference.to_proto());
            } else {
                self.unmatched.push((tick, quaternion));
            }
        }
    }

    /// Returns the reference attitude of a tick.
    fn reference(&self, tick: u64) -> Option<Reference> {
        self.references[tick as usize % MAX_REFERENCES].filter(|reference| reference.tick == tick)
    }

    fn push_imu(&mut self, bytes: &[u8]) {
        let Some(sample) = read::<ImuSample>(bytes) else { return };
        self.extend_range(Quantity::ForceMS2, norm(sample.force_m_s2));
        let axes = [Quantity::RateXRadS, Quantity::RateYRadS, Quantity::RateZRadS];
        axes.into_iter().zip(sample.rate_rad_s).for_each(|(axis, rate_rad_s)| self.extend_range(axis, rate_rad_s));
        self.snapshot.flags |= sample.header.flags.0;
        self.snapshot.imu = Some(sample.to_proto());
    }

    fn push_mag(&mut self, bytes: &[u8]) {
        let Some(sample) = read::<MagSample>(bytes) else { return };
        self.extend_range(Quantity::FieldUt, norm(sample.field_ut));
        self.snapshot.mag = Some(sample.to_proto());
    }

    fn push_fused(&mut self, bytes: &[u8]) {
        let Some(state) = read::<FusedState>(bytes) else { return };
        self.extend_range(Quantity::InnovationRad, state.innovation_rad);
        self.snapshot.fused = Some(state.to_proto());
    }

    fn push_attitude(&mut self, bytes: &[u8]) {
        let Some(attitude) = read::<AttitudeOutput>(bytes) else { return };
        let header = attitude.header;
        self.extend_range(Quantity::LatencyS, header.t_sent_ns.saturating_sub(header.t_born_ns) as f64 * 1e-9);
        self.snapshot.flags |= header.flags.0;
        if self.attitudes.len() < MAX_ATTITUDES {
            self.attitudes.push((header.tick, attitude.quaternion));
        }
        self.snapshot.attitude = Some(attitude.to_proto());
    }

    fn extend_range(&mut self, quantity: Quantity, value: f64) {
        if value.is_finite() {
            let range = self.extremes[quantity as usize].get_or_insert([value; 2]);
            *range = [range[0].min(value), range[1].max(value)];
        }
    }
}

/// Returns the angle of the rotation between two attitudes, from 0 to π rad.
fn angle_rad(a: [f64; 4], b: [f64; 4]) -> f64 {
    let [a, b] = [a, b].map(|[w, x, y, z]| Quaternion::new(w, x, y, z));
    let rotation = a.conjugate() * b;
    // The norm of the vector part remains accurate for small angles.
    2.0 * rotation.imag().norm().atan2(rotation.w.abs())
}

fn norm([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

fn read<M: Payload>(bytes: &[u8]) -> Option<M> {
    bytemuck::try_pod_read_unaligned(bytes).ok()
}

fn store<M: Payload>(bytes: &[u8], slot: &mut Option<M::Proto>) {
    if let Some(message) = read::<M>(bytes) {
        *slot = Some(message.to_proto());
    }
}

/// Replaces the element of `all` that matches `new`, or appends `new`.
fn upsert<T>(all: &mut Vec<T>, new: T, same: impl Fn(&T, &T) -> bool) {
    match all.iter_mut().find(|one| same(one, &new)) {
        Some(one) => *one = new,
        None => all.push(new),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attitude(tick: u64, quaternion: [f64; 4]) -> AttitudeOutput {
        let mut attitude: AttitudeOutput = bytemuck::Zeroable::zeroed();
        attitude.header.tick = tick;
        (attitude.header.t_born_ns, attitude.header.t_sent_ns) = (1_000, 51_000);
        attitude.quaternion = quaternion;
        attitude
    }

    fn rotated(about_x_rad: f64) -> [f64; 4] {
        [(about_x_rad / 2.0).cos(), (about_x_rad / 2.0).sin(), 0.0, 0.0]
    }

    #[test]
    fn snapshot_has_newest_sample_and_extremes_then_resets() {
        let mut decimator = Decimator::default();
        for (tick, force) in [(1, 9.0), (2, 30.0), (3, 9.5)] {
            let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
            (sample.header.tick, sample.force_m_s2) = (tick, [0.0, 0.0, force]);
            decimator.push(Topic::Imu, bytemuck::bytes_of(&sample));
        }
        let snapshot = decimator.take_snapshot(7);
        assert_eq!((snapshot.number, snapshot.t_created_ns), (0, 7));
        assert_eq!(snapshot.imu.and_then(|imu| imu.header).map(|header| header.tick), Some(3));
        let force = snapshot.extremes.iter().find(|one| one.quantity() == Quantity::ForceMS2).unwrap();
        assert_eq!((force.min, force.max), (9.0, 30.0), "the range includes peaks between two snapshots");
        let next = decimator.take_snapshot(8);
        assert_eq!((next.number, next.imu, next.extremes), (1, None, Vec::new()));
    }

    #[test]
    fn error_compares_same_tick_in_either_order() {
        for reference_first in [true, false] {
            let mut decimator = Decimator::default();
            let estimate = attitude(7, rotated(0.3));
            let reference = Reference { tick: 7, t_end_ns: 0, scored: 1, quaternion: rotated(0.1) };
            let other = Reference { tick: 8, t_end_ns: 0, scored: 1, quaternion: rotated(2.0) };
            decimator.push(Topic::Reference, bytemuck::bytes_of(&other));
            if reference_first {
                decimator.push(Topic::Reference, bytemuck::bytes_of(&reference));
                decimator.push(Topic::Attitude, bytemuck::bytes_of(&estimate));
            } else {
                decimator.push(Topic::Attitude, bytemuck::bytes_of(&estimate));
                decimator.push(Topic::Reference, bytemuck::bytes_of(&reference));
            }
            let snapshot = decimator.take_snapshot(0);
            let error = snapshot.extremes.iter().find(|one| one.quantity() == Quantity::ErrorRad).unwrap();
            assert!((error.max - 0.2).abs() < 1e-12, "{error:?}");
            assert_eq!(snapshot.reference.map(|reference| reference.tick), Some(7));
            let latency = snapshot.extremes.iter().find(|one| one.quantity() == Quantity::LatencyS).unwrap();
            assert!((latency.max - 50e-6).abs() < 1e-15, "{latency:?}");
        }
    }

    #[test]
    fn late_reference_yields_error_in_next_snapshot() {
        let mut decimator = Decimator::default();
        decimator.push(Topic::Attitude, bytemuck::bytes_of(&attitude(7, rotated(0.3))));
        assert!(decimator.take_snapshot(0).extremes.iter().all(|range| range.quantity() != Quantity::ErrorRad));
        let reference = Reference { tick: 7, t_end_ns: 0, scored: 1, quaternion: rotated(0.1) };
        for expected in [Some(0.2), None] {
            decimator.push(Topic::Reference, bytemuck::bytes_of(&reference));
            let extremes = decimator.take_snapshot(1).extremes;
            let error_rad = extremes.iter().find(|range| range.quantity() == Quantity::ErrorRad).map(|range| range.max);
            assert_eq!(error_rad.map(|error_rad| (error_rad * 1e9).round() / 1e9), expected);
        }
    }

    #[test]
    fn angle_is_exact_and_ignores_quaternion_sign() {
        for angle in [1e-9, 1e-4, 0.5, 3.0] {
            let (a, b) = (rotated(0.2), rotated(0.2 + angle));
            assert!((angle_rad(a, b) - angle).abs() < 1e-12, "{angle}");
            assert!((angle_rad(a, b.map(|part| -part)) - angle).abs() < 1e-12, "{angle}");
        }
    }

    #[test]
    fn invalid_values_are_ignored_and_events_are_bounded() {
        let mut decimator = Decimator::default();
        let mut sample: ImuSample = bytemuck::Zeroable::zeroed();
        sample.rate_rad_s = [f64::NAN, 1.0, f64::INFINITY];
        decimator.push(Topic::Imu, bytemuck::bytes_of(&sample));
        decimator.push(Topic::Imu, &[1, 2, 3]);
        for number in 0..(MAX_EVENTS as u64 + 5) {
            let event = SystemEvent { number, ..bytemuck::Zeroable::zeroed() };
            decimator.push(Topic::Event, bytemuck::bytes_of(&event));
        }
        let snapshot = decimator.take_snapshot(0);
        let quantities: Vec<_> = snapshot.extremes.iter().map(Extremes::quantity).collect();
        assert_eq!(quantities, [Quantity::ForceMS2, Quantity::RateYRadS]);
        assert_eq!((snapshot.events.len(), snapshot.events[0].number), (MAX_EVENTS, 5));
    }
}
