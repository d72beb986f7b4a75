//! Progress display on standard error: live lines on a terminal, one line per second in a log.

mod painter;

use std::time::{Duration, Instant};

use launch::{Service, Source};
use messages::{Flags, Health};
use pipeline::Collector;
use runtime::Pace;
use supervision::{ProcessEntry, Supervision};

use self::painter::{Frame, Painter};
use crate::{Plan, error::UpError, report::LatencyUs};

/// Time without a health report after which a service is shown as silent.
const SILENCE_THRESHOLD: Duration = Duration::from_millis(500);
/// Number of lines above the services: header, attitude, error, throughput.
const HEADER_LINES: usize = 4;
/// Interval between two progress lines if the output is a log.
const LINE_INTERVAL: Duration = Duration::from_secs(1);

pub(crate) struct View {
    painter: Painter,
    header: String,
    ticks: Option<u64>,
    rate_hz: f64,
    has_reference: bool,
    /// `true` if only events, warnings and errors are shown.
    quiet: bool,
    last_line: Instant,
    last_line_ticks: u64,
    ticks_per_s: f64,
    /// Set once the failure of the output file has been announced.
    output_error_announced: bool,
}

impl View {
    pub(crate) fn new(plan: &Plan) -> Result<Self, UpError> {
        let painter = Painter::new(HEADER_LINES + plan.config.launch.services.len(), plan.ticks, plan.quiet)?;
        let header = header(plan);
        if !painter.is_terminal() && !plan.quiet {
            painter.print_line(header.clone());
        }
        Ok(Self {
            painter,
            header,
            ticks: plan.ticks,
            rate_hz: plan.config.rate_hz,
            has_reference: plan.has_reference,
            quiet: plan.quiet,
            last_line: Instant::now(),
            last_line_ticks: 0,
            ticks_per_s: 0.0,
            output_error_announced: false,
        })
    }

    /// Shows the progress. For a system of processes, also shows the state of each process. `now`
    /// is the supervisor's time.
    pub(crate) fn show(&mut self, collector: &Collector, supervision: Option<&Supervision>, now: Duration) {
        let elapsed_s = self.last_line.elapsed().as_secs_f64();
        let ticks = collector.ticks();
        if let Some(error) =
            collector.file_error().filter(|_| !std::mem::replace(&mut self.output_error_announced, true))
        {
            self.announce([error.to_string()]);
        }
        let is_new_line = self.last_line.elapsed() >= LINE_INTERVAL;
        if is_new_line {
            self.ticks_per_s = (ticks - self.last_line_ticks) as f64 / elapsed_s;
            (self.last_line, self.last_line_ticks) = (Instant::now(), ticks);
        }
        if self.quiet {
            return;
        }
        let (attitude, error) = (attitude(collector), self.error(collector));
        if self.painter.is_terminal() {
            let services = supervision.into_iter().flat_map(Supervision::entries);
            let services = services.map(|(service, entry)| service_line(service, entry, now));
            let statistics = collector.last().map(|_| [error, self.flow(collector)]);
            self.painter.show_frame(Frame {
                lines: [self.header.clone(), attitude]
                    .into_iter()
                    .chain(statistics.into_iter().flatten())
                    .chain(services)
                    .collect(),
                progress: self
                    .ticks
                    .map(|_| (collector.next_tick(), format!("{:.1} × real time", self.ticks_per_s / self.rate_hz))),
            });
        } else if is_new_line {
            let share = self.ticks.map_or(String::new(), |all| format!(" of {all}"));
            self.announce([match collector.last() {
                Some(_) => {
                    format!("tick {}{share}: {attitude}; {error}; {}", collector.next_tick(), self.flow(collector))
                }
                None => attitude,
            }]);
        }
    }

    /// Prints lines that stay on the terminal.
    pub(crate) fn announce(&self, lines: impl IntoIterator<Item = String>) {
        lines.into_iter().for_each(|line| self.painter.print_line(line));
    }

    /// Writes the remaining lines. The last frame stays on the terminal.
    pub(crate) fn finish(&self) {
        self.painter.finish();
    }

    fn error(&self, collector: &Collector) -> String {
        let accuracy = collector.accuracy();
        match accuracy.rmse() {
            Some(rmse) => {
                let [now_deg, rmse_deg, max_deg] =
                    [accuracy.last, rmse, accuracy.max].map(|error| error.inclination_deg);
                format!("inclination error {now_deg:.3}° now, {rmse_deg:.3}° RMSE, {max_deg:.3}° max")
            }
            None if self.has_reference => "no reference yet".into(),
            None => "the source has no reference attitude".into(),
        }
    }

    fn flow(&self, collector: &Collector) -> String {
        let latency = LatencyUs::from_collector(collector);
        let lost = collector.lost();
        format!("{:.0} ticks/s, lost {lost}, latency {latency}", self.ticks_per_s)
    }
}

fn header(plan: &Plan) -> String {
    let launch = &plan.config.launch;
    let source = match launch.ingest.source {
        _ if launch.gateway.import.is_some() => "slots on another host".into(),
        Source::Sim => format!("simulation {}", launch.ingest.sim.scenario),
        Source::Replay => foreign::path(plan.recording.as_ref().unwrap_or(&launch.ingest.replay.file)).to_string(),
        Source::Bus => "sensors on the bus".into(),
        Source::Iio => launch.ingest.live.iio.device.clone(),
        Source::Stdin | Source::Udp | Source::Tcp | Source::Serial | Source::Mavlink => {
            launch.ingest.port().map_or_else(String::new, |port| port.to_string())
        }
    };
    let pace = match plan.config.pace {
        Pace::Max => ", as fast as possible".into(),
        Pace::Speed(1.0) => String::new(),
        Pace::Speed(speed) => format!(", speed {speed}"),
    };
    let [gyro, accel, fuser] = [&launch.gyro, &launch.accel, &launch.fuser].map(|slot| &slot.stage);
    let declared_hz = launch.ingest.declared_rate_hz();
    let rate_hz = if launch.ingest.source == Source::Replay { Some(plan.config.rate_hz) } else { declared_hz };
    let rate = rate_hz.map_or(String::new(), |rate_hz| format!(" at {rate_hz:.0} Hz"));
    format!("{}: {source}{rate}{pace}; {gyro} + {accel} → {fuser}; press Ctrl-C to stop", launch.name)
}

fn attitude(collector: &Collector) -> String {
    let Some(output) = collector.last() else { return "no attitude yet".into() };
    let [yaw, pitch, roll, course] =
        [output.yaw_rad, output.pitch_rad, output.roll_rad, output.course_rad].map(f64::to_degrees);
    format!(
        "yaw {yaw:+7.2}°  pitch {pitch:+6.2}°  roll {roll:+7.2}°  course {course:5.1}° ({})",
        output.course_reference.name()
    )
}

fn service_line(service: Service, entry: &ProcessEntry, now: Duration) -> String {
    let state = entry.state(now, SILENCE_THRESHOLD);
    let restarts = if entry.restarts() > 0 { format!("  restarts {}", entry.restarts()) } else { String::new() };
    let Some(health) = entry.health() else { return format!("  {service:<7} {state}{restarts}") };
    let Health { ticks, lost, pid, late_wakes, .. } = *health;
    let notable = Flags(health.flags.0 & !Flags::INFORMATIONAL.0);
    let late = if late_wakes > 0 { format!("  woken late {late_wakes}") } else { String::new() };
    format!("  {service:<7} {state:<10} pid {pid:<7} {ticks:>9} ticks  lost {lost}{restarts}{late}  {notable}")
}
