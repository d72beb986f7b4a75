//! The lines of the file of attitudes, each of an attitude and the fused state of its tick.
//!
//! Input: attitudes and fused states, each in the order of ticks. Output: the lines, in that order. Time: an attitude waits for its fused state until one of
//! a later tick has come. Failure: an attitude whose fused state did not come has its line without, and is counted.

use std::collections::VecDeque;

use messages::{AttitudeOutput, FusedState};

use crate::{CollectorError, columns::OutFile, out::Out};

/// Attitudes, and fused states, that wait for each other: twice what a topic holds.
const MAX_WAITING: usize = 2 * launch::MAX_TOPIC_MESSAGES;

pub(crate) struct Lines {
    file: OutFile,
    out: Out,
    attitudes: VecDeque<AttitudeOutput>,
    fused: VecDeque<FusedState>,
    without_fused: u64,
}

impl Lines {
    pub(crate) fn create(file: &OutFile) -> Result<Self, CollectorError> {
        Ok(Self {
            out: Out::create(&file.path, file.head())?,
            file: file.clone(),
            attitudes: VecDeque::new(),
            fused: VecDeque::new(),
            without_fused: 0,
        })
    }

    /// Takes the attitude of a tick. Once that has failed nothing more is taken.
    pub(crate) fn attitude(&mut self, output: &AttitudeOutput) -> Result<(), CollectorError> {
        if !self.file.needs_fused() {
            return self.write(output, None);
        }
        self.attitudes.push_back(*output);
        self.join()
    }

    /// Takes the fused state of a tick.
    pub(crate) fn fused(&mut self, state: &FusedState) -> Result<(), CollectorError> {
        if self.fused.len() >= MAX_WAITING {
            self.fused.pop_front();
        }
        self.fused.push_back(*state);
        self.join()
    }

    /// Lines whose fused state did not come.
    pub(crate) fn without_fused(&self) -> u64 {
        self.without_fused
    }

    /// Waits until everything is written; how many lines lack their fused state.
    pub(crate) fn finish(mut self) -> (u64, Result<(), CollectorError>) {
        let mut written = Ok(());
        while let Some(output) = self.attitudes.pop_front().filter(|_| written.is_ok()) {
            self.without_fused += 1;
            written = self.write(&output, None);
        }
        (self.without_fused, written.and_then(|()| self.out.finish()))
    }

    fn join(&mut self) -> Result<(), CollectorError> {
        while let Some(output) = self.attitudes.front().copied() {
            let tick = output.header.tick;
            while self.fused.front().is_some_and(|state| state.header.tick < tick) {
                self.fused.pop_front();
            }
            let fused = self.fused.pop_front_if(|state| state.header.tick == tick);
            // Fused states come in the order of ticks.
            let is_late = self.fused.is_empty() && self.attitudes.len() < MAX_WAITING;
            if fused.is_none() && is_late {
                return Ok(());
            }
            self.attitudes.pop_front();
            self.without_fused += u64::from(fused.is_none());
            self.write(&output, fused.as_ref())?;
        }
        Ok(())
    }

    fn write(&mut self, output: &AttitudeOutput, fused: Option<&FusedState>) -> Result<(), CollectorError> {
        self.file.line(output, fused, self.out.lines());
        self.out.line_added()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use std::fs;

    use bytemuck::Zeroable;

    use super::*;
    use crate::columns::Column;

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
    fn each_line_has_the_fused_state_of_its_tick_whichever_comes_first() {
        let folder = tempfile::tempdir().unwrap();
        let file = OutFile { columns: vec![Column::Bias], ..OutFile::new(folder.path().join("out.csv")) };
        let mut lines = Lines::create(&file).unwrap();
        lines.fused(&fused(0)).unwrap();
        [0, 1, 2].iter().for_each(|tick| lines.attitude(&attitude(*tick)).unwrap());
        // Of tick 2 none comes, and of tick 3 no attitude.
        [1, 3, 4].iter().for_each(|tick| lines.fused(&fused(*tick)).unwrap());
        [4, 5].iter().for_each(|tick| lines.attitude(&attitude(*tick)).unwrap());
        let (without, written) = lines.finish();
        written.unwrap();
        assert_eq!(without, 2);
        let text = fs::read_to_string(file.path).unwrap();
        let biases: Vec<_> = text.lines().skip(1).map(|line| line.split(',').nth(5).unwrap().to_owned()).collect();
        assert_eq!(biases, ["0", "1", "nan", "4", "nan"]);
    }
}
