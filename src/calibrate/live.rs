//! Calibration from a running system, with a progress bar that shows the coverage.

use std::{
    thread,
    time::{Duration, Instant},
};

use ::calibrate::{Calibrator, Kind, Prior, Report};
use bus::{BusError, Observer, Tap};
use control::{ControlRequest, send_request};
use graph::Topic;
use observe::readings::{self, ReadingsError, ReadingsTopic};
use runtime::ServiceConfig;

use crate::{
    failure::Failure,
    notice::{notice, progress_bar},
    topics::{POLL_INTERVAL, StopCondition, observer},
};

/// Default time limit.
const DEFAULT_TIMEOUT: Duration = Duration::from_secs(300);
/// Interval between two updates of the progress bar.
const UPDATE_INTERVAL: Duration = Duration::from_millis(200);
/// Interval between two attempts to compute the result once the coverage is complete.
const ATTEMPT_INTERVAL: Duration = Duration::from_secs(2);
/// Maximum wait for a topic to be opened.
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);

pub(super) fn calibrate_system(
    kind: Kind,
    mut known: Prior,
    system: &str,
    duration: Option<Duration>,
) -> Result<Report, Failure> {
    let observer = observer(system, "calibrate")?;
    let config = send_request::<ServiceConfig>(system, &ControlRequest::ServiceConfig)?;
    readings::apply_system(&mut known, &config).map_err(ReadingsError::from)?;
    let limit = duration.unwrap_or(DEFAULT_TIMEOUT);
    let mut stop = StopCondition::new(|| observer.is_running(), Some(limit));
    let topic = readings::readings_topic(&config)?;
    let tap = open_tap(&observer, topic.topic(), &mut stop)?;
    let mut calibrator = Calibrator::new(kind, &known);
    let first = calibrator.coverage().missing.into_iter().next().unwrap_or_default();
    notice(format_args!("reading sensors of {system:?}; still needed: {first}"));
    let bar = progress_bar(100, "{bar:40} {percent:>3} % {wide_msg}");
    let (mut updated_at, mut attempted_at) = (Instant::now(), None::<Instant>);
    while !stop.is_met() {
        drain(&tap, topic, &mut calibrator)?;
        if updated_at.elapsed() >= UPDATE_INTERVAL {
            updated_at = Instant::now();
            let coverage = calibrator.coverage();
            bar.set_position(coverage.percent() as u64);
            bar.set_message(coverage.missing.first().cloned().unwrap_or(coverage.summary));
            if coverage.share >= 1.0
                && attempted_at.is_none_or(|attempted_at| attempted_at.elapsed() >= ATTEMPT_INTERVAL)
            {
                if calibrator.finish().is_ok() {
                    break;
                }
                attempted_at = Some(Instant::now());
            }
        }
        thread::sleep(POLL_INTERVAL);
    }
    bar.finish_and_clear();
    Ok(calibrator.finish()?)
}

/// Opens a topic. Waits if it is not open yet, because the publisher may start later than the
/// system.
fn open_tap(observer: &Observer, topic: Topic, stop: &mut StopCondition<'_>) -> Result<Tap, BusError> {
    let started = Instant::now();
    loop {
        match observer.tap(topic) {
            Err(BusError::TopicNotOpen { .. }) if started.elapsed() < OPEN_TIMEOUT && !stop.is_met() => {
                thread::sleep(POLL_INTERVAL)
            }
            result => return result,
        }
    }
}

/// Processes all available messages. Overwritten messages leave a gap, which ends the current rest
/// or rotation.
fn drain(tap: &Tap, topic: ReadingsTopic, calibrator: &mut Calibrator) -> Result<(), BusError> {
    tap.drain(&mut |bytes| topic.decode(bytes).iter().for_each(|sample| calibrator.push(sample)))?;
    Ok(())
}
