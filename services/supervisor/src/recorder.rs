//! Recording of a run from its first tick.

use std::{fs, os::unix::fs::DirBuilderExt, path::Path};

use flight::{FlightError, FlightHeader, Recorder, RecordingMode, RecordingSummary};
use graph::Topic;
use launch::TickSource;
use runtime::ServiceConfig;

use crate::{
    plan::{Request, launch_text},
    report::{RecordingReport, Report},
    terminal::announce,
};

/// Creates the recording of a run as a new file in `folder`.
pub(crate) fn create(folder: &Path, request: &Request, config: &ServiceConfig) -> Result<Recorder, FlightError> {
    let created = fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
    created.map_err(|cause| FlightError::Create { path: folder.to_owned(), cause })?;
    let path = flight::unused_path(folder, &config.launch.name)?;
    let mode = match config.launch.tick_source() {
        // The ticks come from another host and need not begin with the first one.
        TickSource::Gateway => RecordingMode::FromAnyTick,
        TickSource::Ingest if config.is_lockstep() => RecordingMode::Lockstep,
        TickSource::Ingest => RecordingMode::FromFirstTick,
    };
    let header = FlightHeader {
        launch_file: request.launch.clone(),
        launch: launch_text(request.launch.as_deref()).ok().and_then(|text| {
            match (request.source.as_deref(), request.receiver.as_deref()) {
                (None, None) => Some(text),
                (source, receiver) => launch::with_overrides(&text, source, receiver),
            }
        }),
        ..FlightHeader::new(env!("CARGO_PKG_VERSION"), config)
    };
    let recorder = Recorder::create(&path, &header, Topic::ALL, mode)?;
    announce(format_args!("recording to {}", foreign::path(&path)));
    Ok(recorder)
}

/// Finishes the recording with the report of the run.
pub(crate) fn finish(recorder: Recorder, report: &Report) -> RecordingReport {
    let end_reason = report.error.as_deref().unwrap_or("ended normally");
    let RecordingSummary { file, messages, missed, bytes, error, .. } =
        recorder.finish(end_reason, Some(report.to_json()));
    RecordingReport { file, messages, missed, bytes, error }
}
