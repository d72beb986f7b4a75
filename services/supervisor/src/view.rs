//! What people see while a system runs: a few live lines on a terminal, a line a second in a log; on standard error.

use std::{
    io::IsTerminal,
    time::{Duration, Instant},
};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use launch::{Service, Source};
use messages::{Flags, Health};
use runtime::Pace;

use crate::{
    Plan,
    collector::Collector,
    crew::{Crew, Post},
    report::LatencyUs,
    tell,
};

/// Terminal frames per second at most.
const FRAMES_HZ: u8 = 10;
/// A service that has said nothing for so long is shown as silent.
const SILENT: Duration = Duration::from_millis(500);
/// Between two lines of a log.
const LINE_INTERVAL: Duration = Duration::from_secs(1);

pub(crate) struct View {
    lines: Option<Lines>,
    ticks: Option<u64>,
    rate_hz: f64,
    has_reference: bool,
    shown: Instant,
    shown_ticks: u64,
    ticks_per_s: f64,
    /// That the file has ended before its time is said once.
    out_ended: bool,
}

/// The live lines of a terminal.
struct Lines {
    all: MultiProgress,
    text: Vec<ProgressBar>,
    progress: Option<ProgressBar>,
}

/// Lines above the services: head, attitude, error, flow.
const HEAD_LINES: usize = 4;

impl View {
    pub(crate) fn new(plan: &Plan) -> Self {
        let lines = std::io::stderr().is_terminal().then(|| Lines::new(plan));
        if lines.is_none() {
            tell(head(plan));
        }
        Self {
            lines,
            ticks: plan.ticks,
            rate_hz: plan.orders.rate_hz,
            has_reference: plan.has_reference,
            shown: Instant::now(),
            shown_ticks: 0,
            ticks_per_s: 0.0,
            out_ended: false,
        }
    }

    pub(crate) fn show(&mut self, collector: &Collector, crew: Option<&Crew>) {
        let elapsed_s = self.shown.elapsed().as_secs_f64();
        let ticks = collector.ticks();
        if let Some(error) = collector.out_ended().filter(|_| !std::mem::replace(&mut self.out_ended, true)) {
            self.announce(&[error.to_string()]);
        }
        if self.shown.elapsed() >= LINE_INTERVAL {
            self.ticks_per_s = (ticks - self.shown_ticks) as f64 / elapsed_s;
            (self.shown, self.shown_ticks) = (Instant::now(), ticks);
            if self.lines.is_none() {
                let share = self.ticks.map_or(String::new(), |all| format!(" of {all}"));
                let (attitude, error, flow) = (attitude(collector), self.error(collector), self.flow(collector));
                tell(format_args!("tick {ticks}{share}: {attitude}; {error}; {flow}"));
            }
        }
        let flow = self.flow(collector);
        let Some(lines) = &self.lines else { return };
        lines.text[1].set_message(attitude(collector));
        lines.text[2].set_message(self.error(collector));
        lines.text[3].set_message(flow);
        for (line, (service, post)) in lines.text[HEAD_LINES..].iter().zip(crew.into_iter().flat_map(Crew::posts)) {
            line.set_message(service_line(service, post));
        }
        if let Some(progress) = &lines.progress {
            progress.set_position(ticks);
            progress.set_message(format!("{:.1} × real time", self.ticks_per_s / self.rate_hz));
        }
    }

    /// What has happened, on lines that stay.
    pub(crate) fn announce(&self, news: &[String]) {
        for line in news {
            match &self.lines {
                // A terminal that cannot be written to shows nothing.
                Some(lines) => drop(lines.all.println(line)),
                None => tell(line),
            }
        }
    }

    /// The last picture stays.
    pub(crate) fn end(&mut self) {
        if let Some(lines) = &self.lines {
            lines.text.iter().chain(&lines.progress).for_each(ProgressBar::abandon);
        }
    }

    fn error(&self, collector: &Collector) -> String {
        let accuracy = collector.accuracy();
        match accuracy.rmse() {
            Some(rmse) => {
                let [now_deg, rmse_deg, max_deg] =
                    [accuracy.now, rmse, accuracy.max].map(|error| error.inclination_deg);
                format!("inclination error {now_deg:.3}° now, {rmse_deg:.3}° RMSE, {max_deg:.3}° max")
            }
            None if self.has_reference => "no reference yet".into(),
            None => "the source has no reference attitude".into(),
        }
    }

    fn flow(&self, collector: &Collector) -> String {
        let latency = LatencyUs::of(collector);
        let lost = collector.lost();
        format!("{:.0} ticks/s, lost {lost}, latency {latency}", self.ticks_per_s)
    }
}

impl Lines {
    fn new(plan: &Plan) -> Self {
        let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(FRAMES_HZ));
        let style = ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        let text: Vec<_> = (0..HEAD_LINES + plan.orders.launch.services.len())
            .map(|_| all.add(ProgressBar::new_spinner().with_style(style.clone())))
            .collect();
        text[0].set_message(head(plan));
        let progress = plan.ticks.map(|ticks| {
            let style = ProgressStyle::with_template("{bar:40} {percent:>3} % of {len} ticks, {msg}, {eta} left")
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            all.add(ProgressBar::new(ticks).with_style(style))
        });
        Self { all, text, progress }
    }
}

fn head(plan: &Plan) -> String {
    let launch = &plan.orders.launch;
    let source = match launch.ingest.source {
        _ if launch.gateway.import.is_some() => "slots on another host".into(),
        Source::Sim => format!("simulation {}", launch.ingest.sim.scenario),
        Source::Replay => launch.ingest.replay.file.display().to_string(),
        Source::Bus => "sensors on the bus".into(),
    };
    let pace = match plan.orders.pace {
        Pace::Max => ", as fast as possible".into(),
        Pace::Speed(1.0) => String::new(),
        Pace::Speed(speed) => format!(", speed {speed}"),
    };
    let [gyro, accel, fuser] = [&launch.gyro, &launch.accel, &launch.fuser].map(|slot| &slot.stage);
    let rate_hz = plan.orders.rate_hz;
    format!("{}: {source} at {rate_hz:.0} Hz{pace}; {gyro} + {accel} → {fuser}; Ctrl-C ends it", launch.name)
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

fn service_line(service: Service, post: &Post) -> String {
    let standing = post.standing(SILENT);
    let restarts = if post.restarts() > 0 { format!("  restarts {}", post.restarts()) } else { String::new() };
    let Some(health) = post.heard() else { return format!("  {service:<7} {standing}{restarts}") };
    let Health { ticks, lost, pid, late_wakes, .. } = *health;
    let notable = Flags(health.flags.0 & !Flags::USUAL.0);
    let late = if late_wakes > 0 { format!("  woken late {late_wakes}") } else { String::new() };
    format!("  {service:<7} {standing:<10} pid {pid:<7} {ticks:>9} ticks  lost {lost}{restarts}{late}  {notable}")
}
