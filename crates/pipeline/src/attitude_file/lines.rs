//! Joins attitudes and fused states of the same tick into the lines of the attitude file.
//!
//! Input: attitudes and fused states, each in tick order.
//!
//! Output: lines in tick order.
//!
//! Time: an attitude is held until its fused state or the fused state of a later tick arrives.
//!
//! Failure: an attitude without a fused state is written with empty values and counted.

use std::collections::VecDeque;

use messages::{AttitudeOutput, FusedState};

use super::{columns::AttitudeFile, csv_writer::CsvWriter};
use crate::error::CollectorError;

/// Maximum number of attitudes held until their fused states arrive. It also limits the fused
/// states held until their attitudes arrive. The number is twice the capacity of a topic.
const MAX_PENDING: usize = 2 * launch::MAX_TOPIC_MESSAGES;

pub(crate) struct AttitudeLines {
    file: AttitudeFile,
    writer: CsvWriter,
    attitudes: VecDeque<AttitudeOutput>,
    fused: VecDeque<FusedState>,
    lines_without_fused: u64,
}

impl AttitudeLines {
    pub(crate) fn create(file: &AttitudeFile) -> Result<Self, CollectorError> {
        Ok(Self {
            writer: CsvWriter::create(&file.path, file.header())?,
            file: file.clone(),
            attitudes: VecDeque::new(),
            fused: VecDeque::new(),
            lines_without_fused: 0,
        })
    }

    /// Records the attitude of a tick. After an error the file accepts no more data.
    pub(crate) fn push_attitude(&mut self, output: &AttitudeOutput) -> Result<(), CollectorError> {
        if !self.file.needs_fused() {
            return self.write(output, None);
        }
        self.attitudes.push_back(*output);
        self.join()
    }

    /// Records the fused state of a tick.
    pub(crate) fn push_fused(&mut self, state: &FusedState) -> Result<(), CollectorError> {
        if self.fused.len() >= MAX_PENDING {
            self.fused.pop_front();
        }
        self.fused.push_back(*state);
        self.join()
    }

    /// Returns the number of lines written without a fused state.
    pub(crate) fn lines_without_fused(&self) -> u64 {
        self.lines_without_fused
    }

    /// Writes all pending lines and waits for the disk. Also returns the number of lines without a
    /// fused state.
    pub(crate) fn finish(mut self) -> (u64, Result<(), CollectorError>) {
        let mut written = Ok(());
        while let Some(output) = self.attitudes.pop_front().filter(|_| written.is_ok()) {
            self.lines_without_fused += 1;
            written = self.write(&output, None);
        }
        (self.lines_without_fused, written.and_then(|()| self.writer.finish()))
    }

    fn join(&mut self) -> Result<(), CollectorError> {
        while let Some(output) = self.attitudes.front().copied() {
            let tick = output.header.tick;
            while self.fused.front().is_some_and(|state| state.header.tick < tick) {
                self.fused.pop_front();
            }
            let fused = self.fused.pop_front_if(|state| state.header.tick == tick);
            // Fused states arrive in tick order. If a later one has arrived, that of this tick is
            // missing.
            let may_arrive = self.fused.is_empty() && self.attitudes.len() < MAX_PENDING;
            if fused.is_none() && may_arrive {
                return Ok(());
            }
            self.attitudes.pop_front();
            self.lines_without_fused += u64::from(fused.is_none());
            self.write(&output, fused.as_ref())?;
        }
        Ok(())
    }

    fn write(&mut self, output: &AttitudeOutput, fused: Option<&FusedState>) -> Result<(), CollectorError> {
        self.file.append_line(output, fused, self.writer.buffer());
        self.writer.send_full_batch()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use bytemuck::Zeroable;

    use super::*;
    use crate::attitude_file::columns::Column;

    fn attitude(tick: u64) -> AttitudeOutput {
        let mut output = AttitudeOutput::zeroed();
        output.header.tick = tick;
        output
    }

    fn fused(tick: u64) -> FusedState {
        let mut state = FusedState { bias_rad_s: [tick as f64, 0.5, -0.5], ..FusedState::zeroed() };
        state.header.tick = tick;
        state
    }

    #[test]
    fn line_has_fused_state_of_its_tick_in_any_order() {
        let folder = tempfile::tempdir().unwrap();
        let file = AttitudeFile { columns: vec![Column::Bias], ..AttitudeFile::new(folder.path().join("out.csv")) };
        let mut lines = AttitudeLines::create(&file).unwrap();
        lines.push_fused(&fused(0)).unwrap();
        [0, 1, 2].iter().for_each(|tick| lines.push_attitude(&attitude(*tick)).unwrap());
        // Tick 2 has no fused state and tick 3 no attitude.
        [1, 3, 4].iter().for_each(|tick| lines.push_fused(&fused(*tick)).unwrap());
        [4, 5].iter().for_each(|tick| lines.push_attitude(&attitude(*tick)).unwrap());
        let (without, written) = lines.finish();
        written.unwrap();
        assert_eq!(without, 2);
        let text = fs::read_to_string(file.path).unwrap();
        let biases: Vec<_> = text.lines().skip(1).map(|line| line.split(',').nth(5).unwrap().to_owned()).collect();
        assert_eq!(biases, ["0", "1", "nan", "4", "nan"]);
    }
}
