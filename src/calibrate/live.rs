//! A running system is read until there is enough, with a bar that shows the coverage.

use std::{
    thread,
    time::{Duration, Instant},
};

use ::calibrate::{Calibrator, Kind, Known, Refusal, Report};
use bus::{BusError, Observer, Tap};
use control::{ControlError, ControlRequest, ask};
use graph::Topic;
use indicatif::ProgressBar;
use ingest::source::{Reading, SourceError};
use launch::Source;
use messages::{SensorReading, TakenReading};
use runtime::ServiceConfig;

use super::{build_on, sample, style};
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
    Source(#[from] SourceError),
    #[error(
        "calibrating from {system:?}: its source is a simulation or a recording, whose readings are not published; start it by \
         `plumb up --readings`"
    )]
    NotPublished { system: String },
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
    let config = ask::<ServiceConfig>(system, &ControlRequest::ServiceConfig)?;
    build_on(&mut known, &config.launch)?;
    known.rate_kind = config.gyro_samples().rate_kind();
    let limit = duration_s.map_or(LIMIT, Duration::from_secs_f64);
    let mut until = Until::new(|| seat.is_running(), Some(limit));
    let topic = match config.launch.ingest.source {
        _ if config.readings => Topic::Reading,
        Source::Sim | Source::Replay => return Err(LiveError::NotPublished { system: system.into() }),
        _ => Topic::Sensor,
    };
    let tap = opened(&seat, topic, &mut until)?;
    let mut calibrator = Calibrator::new(kind, &known);
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
            Err(BusError::Unopened { .. }) if since.elapsed() < OPEN_LIMIT && !until.is_over() => thread::sleep(LOOK),
            opened => return opened,
        }
    }
}

/// Takes what has come. What was overwritten meanwhile is a gap, which no rest and no turn is taken across.
fn look(tap: &Tap, topic: Topic, calibrator: &mut Calibrator) -> Result<(), BusError> {
    tap.drain(&mut |bytes| {
        let reading = match topic {
            Topic::Reading => bytemuck::try_pod_read_unaligned::<TakenReading>(bytes).ok().map(|it| Reading::from(&it)),
            _ => bytemuck::try_pod_read_unaligned::<SensorReading>(bytes).ok().map(Reading::from),
        };
        reading.iter().for_each(|reading| calibrator.take(&sample(reading)));
    })?;
    Ok(())
}
