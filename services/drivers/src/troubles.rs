//! What is wrong with a device, by what came of it: away, silent, of another format, disturbed, not alone.
//!
//! Input: reports with their times. Output: troubles with their remedies. Time: the caller's.

use std::collections::VecDeque;

use control::Trouble;

use crate::input::Report;

/// The port is not there.
pub(crate) const AWAY: &str = "away";
const SILENT: &str = "silent";
const FORMAT: &str = "format";
const NO_MEASUREMENT: &str = "no-measurement";
const DISTURBED: &str = "disturbed";
const SECOND: &str = "second";
const CLOCK: &str = "clock";

/// What is looked back at, s, at one report a second.
const WINDOW: usize = 10;
/// A device that is open and says nothing for so long is silent, s.
const SILENT_S: usize = 3;
/// Bytes without a message after which they are of another format or speed: many times the longest message that is usual.
const FORMAT_BYTES: u64 = 1024;
/// Messages without a measurement after which there will be none.
const MESSAGES: u64 = 100;
/// Of the messages refused, and of the bytes in none: more than a line loses that is as it should be.
const REFUSED_SHARE: f64 = 0.01;
const SKIPPED_SHARE: f64 = 0.05;
/// Steps back of the clock in the window: more than a device that begins again makes.
const CLOCK_STEPS: u64 = 5;

/// What came of a device in the last seconds.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    /// The prefix of the kinds, where there are two devices.
    of: &'static str,
    reports: VecDeque<(Report, u64)>,
    silent_s: usize,
}

impl Watch {
    pub(crate) fn new(of: &'static str) -> Self {
        Self { of, ..Self::default() }
    }

    /// Takes a report, one each second, with the steps of the device's clock, and says what is wrong.
    pub(crate) fn look(&mut self, report: Report, clock_steps: u64) -> Vec<Trouble> {
        let last_bytes = self.reports.back().map_or(0, |(last, _)| last.bytes);
        let is_silent = report.absence.is_none() && report.bytes == last_bytes;
        self.silent_s = if is_silent { self.silent_s + 1 } else { 0 };
        self.reports.push_back((report, clock_steps));
        if self.reports.len() > WINDOW + 1 {
            self.reports.pop_front();
        }
        let (Some((first, first_steps)), Some((last, _))) = (self.reports.front(), self.reports.back()) else {
            return Vec::new();
        };
        let mut found = Vec::new();
        let mut say = |kind: &str, what: String, remedy: String| {
            found.push(Trouble { kind: format!("{}{kind}", self.of), found: what, remedy });
        };
        let Report { place, format, .. } = last;
        if let Some(absence) = &last.absence {
            say(AWAY, format!("reading {place}: {}", absence.found), format!("{}; it is tried again", absence.remedy));
        } else if self.silent_s >= SILENT_S && *place != "standard input" {
            say(
                SILENT,
                format!("{place} is open, and nothing comes"),
                "does the device send? look at its power, its wires and its settings".into(),
            );
        }
        let counts = last.counts;
        if counts.frames == 0 && last.bytes >= FORMAT_BYTES {
            say(
                FORMAT,
                format!("{place}: {} bytes came, and no message of {format} is among them", last.bytes),
                "are format and baud those of the device?".into(),
            );
            return found;
        }
        if last.measurements == 0 && counts.frames >= MESSAGES {
            say(
                NO_MEASUREMENT,
                format!(
                    "{place}: {} messages of {format} came, and nothing that is wanted is measured in them",
                    counts.frames
                ),
                wanted(format).into(),
            );
        }
        let frames = counts.frames - first.counts.frames;
        let refused = counts.refused - first.counts.refused;
        let skipped = counts.skipped_bytes - first.counts.skipped_bytes;
        let bytes = last.bytes - first.bytes;
        // Other messages between them are the rule there.
        let is_shared = matches!(*format, "mavlink" | "ubx" | "nmea");
        if refused as f64 > REFUSED_SHARE * frames as f64 + 1.0
            || (!is_shared && skipped as f64 > SKIPPED_SHARE * bytes as f64 + 100.0)
        {
            say(
                DISTURBED,
                format!(
                    "{place}: of {bytes} bytes in {WINDOW} s {skipped} are in no message, and {refused} messages were refused beside {frames} good ones"
                ),
                "look at cable, ground, baud, and whether a second device sends on the same line".into(),
            );
        }
        if last.strangers > first.strangers {
            say(
                SECOND,
                format!("{place}: another one sends, too: {} datagrams of it were left out", last.strangers),
                "send them to another port; the one that was heard first is read".into(),
            );
        }
        if clock_steps.saturating_sub(*first_steps) >= CLOCK_STEPS {
            say(
                CLOCK,
                format!(
                    "{place}: the device's time went back or stood still {} times in {WINDOW} s",
                    clock_steps - first_steps
                ),
                "does a second sensor send on the same line? else set clock, units or time_bits right".into(),
            );
        }
        found
    }
}

/// What the device is to send.
fn wanted(format: &str) -> &'static str {
    match format {
        "mavlink" => {
            "let the autopilot stream HIGHRES_IMU, or name another message as imu; on a PX4: mavlink stream -u 14540 -s HIGHRES_IMU -r 200"
        }
        "witmotion" => "switch acceleration (0x51) and rate (0x52) on in the device",
        "xsens" => "switch rate of turn and acceleration on in the device's output configuration",
        "ubx" => "switch UBX-NAV-PVT on in the receiver, and give it a view of the sky",
        "nmea" => "switch RMC or VTG on in the receiver, and give it a view of the sky",
        _ => "send rate and force",
    }
}

#[cfg(test)]
mod tests {
    use decoders::Counts;

    use super::*;
    use crate::line::Absence;

    /// After so many seconds in each of which the same comes.
    fn after(seconds: u64, each: impl Fn(u64) -> (Report, u64)) -> Vec<String> {
        let mut watch = Watch::new("");
        let mut found = Vec::new();
        for second in 1..=seconds {
            let (report, steps) = each(second);
            found = watch.look(Report { place: "/dev/ttyUSB0".into(), ..report }, steps);
        }
        found.into_iter().map(|trouble| trouble.kind).collect()
    }

    fn good(second: u64) -> Report {
        let counts = Counts { frames: 100 * second, refused: 0, skipped_bytes: 0 };
        Report { format: "witmotion", bytes: 3300 * second, counts, measurements: 100 * second, ..Report::default() }
    }

    #[test]
    fn what_is_as_it_should_be_has_no_trouble() {
        assert_eq!(after(30, |second| (good(second), 0)), [""; 0]);
        // Half a frame at the beginning, a device that begins again.
        let begun =
            |second| Report { counts: Counts { skipped_bytes: 40, refused: 1, ..good(second).counts }, ..good(second) };
        assert_eq!(after(5, |second| (begun(second), 1)), [""; 0]);
    }

    #[test]
    fn each_trouble_has_its_name() {
        let away = Absence { found: "no such file".into(), remedy: "plug it in" };
        type Each<'a> = &'a dyn Fn(u64) -> (Report, u64);
        let cases: [(&str, Each<'_>); 7] = [
            (AWAY, &|_| (Report { absence: Some(away.clone()), ..Report::default() }, 0)),
            (SILENT, &|_| (good(1), 0)),
            (FORMAT, &|second| (Report { bytes: 3300 * second, ..Report::default() }, 0)),
            (NO_MEASUREMENT, &|second| (Report { measurements: 0, ..good(second) }, 0)),
            (DISTURBED, &|second| {
                (Report { counts: Counts { refused: 5 * second, ..good(second).counts }, ..good(second) }, 0)
            }),
            (SECOND, &|second| (Report { strangers: second, ..good(second) }, 0)),
            (CLOCK, &|second| (good(second), 50 * second)),
        ];
        for (kind, each) in cases {
            assert_eq!(after(8, each), [kind]);
        }
    }

    #[test]
    fn a_trouble_that_is_over_is_forgotten() {
        let noise = |second: u64| Counts { skipped_bytes: 1000 * second.min(5), ..good(second).counts };
        assert_eq!(after(5, |second| (Report { counts: noise(second), ..good(second) }, 0)), [DISTURBED]);
        assert_eq!(after(20, |second| (Report { counts: noise(second), ..good(second) }, 0)), [""; 0]);
    }
}
