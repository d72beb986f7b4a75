//! A running system is read until there is enough, with a bar that shows the coverage.

use std::{
    thread,
    time::{Duration, Instant},
};

use ::calibrate::{Calibrator, Kind, Known, Refusal, Report};
use bus::{BusError, Observer, Tap};
use control::{ControlError, ControlRequest, send_request};
use graph::Topic;
use indicatif::ProgressBar;
use observe::readings::{self, ReadingsError};
use runtime::ServiceConfig;

use super::style;
use crate::seeing::{LOOK, Until, observer};

/// How long it is read where nobody says it.
const LIMIT: Duration = Duration::from_secs(300);
/// Between two pictures of the coverage.
const SHOW_INTERVAL: Duration = Duration::from_millis(200);
/// Between two trials whether what there is suffices.
const TRY_INTERVAL: Duration = Duration::from_secs(2);
/// How long a topic is looked for that is not there yet.
const OPEN_LIMIT: Duration = Duration::from_secs(10);

/// Why a running system does not calibrate.
#[derive(Debug, thiserror::Error)]
pub(super) enum LiveError {
    #[error(transparent)]
    Bus(#[from] BusError),
    #[error(transparent)]
    Control(#[from] ControlError),
    #[error(transparent)]
    Readings(#[from] ReadingsError),
    #[error(transparent)]
    Refused(#[from] Refusal),
}

impl LiveError {
    pub(super) fn exit_code(&self) -> u8 {
        1
    }
}

pub(super) fn calibrated(
    kind: Kind,
    mut known: Known,
    system: &str,
    duration_s: Option<f64>,
) -> Result<Report, LiveError> {
    let seat = observer(system, "calibrate")?;
    let config = send_request::<ServiceConfig>(system, &ControlRequest::ServiceConfig)?;
    readings::build_on_system(&mut known, &config).map_err(ReadingsError::from)?;
    let limit = duration_s.map_or(LIMIT, Duration::from_secs_f64);
    let mut until = Until::new(|| seat.is_running(), Some(limit));
    let topic = readings::topic(&config)?;
    let tap = opened(&seat, topic, &mut until)?;
    let mut calibrator = Calibrator::new(kind, &known);
    let first = calibrator.coverage().missing.into_iter().next().unwrap_or_default();
    eprintln!("reading the sensors of {system:?} from now on; wanted first: {first}");
    let bar = ProgressBar::new(100).with_style(style("{bar:40} {percent:>3} % {wide_msg}"));
    let (mut shown, mut tried) = (Instant::now(), None::<Instant>);
    while !until.is_over() {
        look(&tap, topic, &mut calibrator)?;
        if shown.elapsed() >= SHOW_INTERVAL {
            shown = Instant::now();
            let coverage = calibrator.coverage();
            bar.set_position(coverage.percent() as u64);
            bar.set_message(coverage.missing.first().cloned().unwrap_or(coverage.found));
            if coverage.share >= 1.0 && tried.is_none_or(|tried| tried.elapsed() >= TRY_INTERVAL) {
                if calibrator.finish().is_ok() {
                    break;
                }
                tried = Some(Instant::now());
            }
        }
        thread::sleep(LOOK);
    }
    bar.finish_and_clear();
    Ok(calibrator.finish()?)
}

/// Reads a topic from now on, once it is there: whoever feeds a system may come later than it.
fn opened(seat: &Observer, topic: Topic, until: &mut Until<'_>) -> Result<Tap, BusError> {
    let since = Instant::now();
    loop {
        match seat.tap(topic) {
            Err(BusError::TopicNotOpen { .. }) if since.elapsed() < OPEN_LIMIT && !until.is_over() => thread::sleep(LOOK),
            opened => return opened,
        }
    }
}

/// Takes what has come. What was overwritten meanwhile is a gap, which no rest and no turn is taken across.
fn look(tap: &Tap, topic: Topic, calibrator: &mut Calibrator) -> Result<(), BusError> {
    tap.drain(&mut |bytes| readings::sample(topic, bytes).iter().for_each(|sample| calibrator.take(sample)))?;
    Ok(())
}
