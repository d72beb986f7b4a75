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

/// The readings of a system as its source gives them.
struct Place {
    tap: Tap,
    topic: Topic,
    observer: Observer,
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
    let place = Place::take(seat, system, &config)?;
    let mut calibrator = Calibrator::new(kind, &known);
    let bar = ProgressBar::new(100).with_style(style("{bar:40} {percent:>3} % {wide_msg}"));
    let mut until = Until::new(|| place.observer.is_running(), Some(duration_s.map_or(LIMIT, Duration::from_secs_f64)));
    let mut shown = Instant::now();
    // The last refusal says what is missing.
    while !until.is_over() {
        place.look(&mut calibrator)?;
        if shown.elapsed() >= SHOW_INTERVAL {
            shown = Instant::now();
            let coverage = calibrator.coverage();
            bar.set_position((100.0 * coverage.share) as u64);
            bar.set_message(coverage.missing.first().cloned().unwrap_or(coverage.found));
            if coverage.share >= 1.0 && calibrator.finish().is_ok() {
                break;
            }
        }
        thread::sleep(LOOK);
    }
    bar.finish_and_clear();
    Ok(calibrator.finish()?)
}

impl Place {
    fn take(observer: Observer, system: &str, config: &ServiceConfig) -> Result<Self, LiveError> {
        let topic = match config.launch.ingest.source {
            _ if config.readings => Topic::Reading,
            Source::Sim | Source::Replay => return Err(LiveError::NotPublished { system: system.into() }),
            _ => Topic::Sensor,
        };
        let since = Instant::now();
        loop {
            match observer.tap(topic) {
                Ok(tap) => return Ok(Self { tap, topic, observer }),
                // Whoever feeds the system may come later than it.
                Err(BusError::Unopened { .. }) if since.elapsed() < OPEN_LIMIT && observer.is_running() => {
                    thread::sleep(LOOK);
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Takes what has come. What was overwritten meanwhile is a gap, which no rest and no turn is taken across.
    fn look(&self, calibrator: &mut Calibrator) -> Result<(), BusError> {
        self.tap.drain(&mut |bytes| {
            let reading = match self.topic {
                Topic::Reading => {
                    bytemuck::try_pod_read_unaligned::<TakenReading>(bytes).ok().map(|it| Reading::from(&it))
                }
                _ => bytemuck::try_pod_read_unaligned::<SensorReading>(bytes).ok().map(Reading::from),
            };
            reading.iter().for_each(|reading| calibrator.take(&sample(reading)));
        })?;
        Ok(())
    }
}
