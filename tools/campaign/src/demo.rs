//! Demonstration: kills and swaps the stages of a tumbling vehicle's system, in about 20 s.

use std::{fmt, path::PathBuf, time::Duration};

use attitude::{
    Quaternion,
    metrics::{Accuracy, AttitudeError},
    point::Point,
};
use bytemuck::bytes_of;
use control::{SwapOutcome, SwapReport, SwapRequest};
use launch::{Launch, Service, StageConfig, pluralize};
use messages::{AttitudeOutput, Ticked};
use nalgebra::{UnitQuaternion, Vector3};
use pipeline::{Path, Schedule};
use readings::source::Readings;
use runtime::{Pace, Sequence, clock::monotonic_ns, service_config::FIRST_EPOCH};
use supervisor::{Plan, Request, UpError};

use crate::{
    CampaignError,
    swaps::run_swap,
    system_under_test::{SystemUnderTest, launch_text},
};

/// Samples per second.
const RATE_HZ: u64 = 1000;
/// Number of seconds of the tumble that are shown before the first fault.
const TUMBLE_S: u64 = 8;
/// Pause after each event.
const PAUSE_NS: u64 = 2_000_000_000;
/// Time limit for the system to exit.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(30);
/// Number of times an aborted swap is repeated; a swap is aborted if the machine is too busy.
const MAX_SWAPS: u32 = 5;

/// Demonstration of kills and swaps.
pub struct Demo {
    /// System name.
    pub name: String,
    /// `true` if this executable contains the cockpit.
    pub has_cockpit: bool,
    /// `true` to stop the system at the end of the demonstration, `false` to let it run until it
    /// is interrupted.
    pub stops: bool,
}

/// Result of a demonstration.
#[derive(Debug, Clone, Copy, Default)]
pub struct DemoReport {
    /// Number of attitudes that were compared with the undisturbed run.
    pub ticks: u64,
    /// Number of ticks without an attitude.
    pub lost: u64,
    /// Number of attitudes that differ from the undisturbed run.
    pub different: u64,
    /// RMSE of the inclination, degrees.
    pub inclination_rmse_deg: f64,
}

impl DemoReport {
    /// Returns `true` if no attitude was lost or changed.
    pub fn passed(&self) -> bool {
        self.ticks > 0 && (self.lost, self.different) == (0, 0)
    }
}

impl fmt::Display for DemoReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ticks, lost, different, inclination_rmse_deg } = self;
        let ticks = pluralize(*ticks, "attitude");
        writeln!(f, "   {ticks}, compared with a run in one process, without kills:")?;
        writeln!(f, "   {lost} lost, {different} different in any bit.")?;
        write!(f, "   Inclination error against the simulated truth: {inclination_rmse_deg:.2}° RMSE.")
    }
}

impl Demo {
    /// Runs the demonstration and passes each line of its text to `show`.
    ///
    /// # Errors
    ///
    /// Returns an error if the system or the undisturbed run fails.
    pub fn run(&self, show: &mut dyn FnMut(String)) -> Result<DemoReport, CampaignError> {
        supervisor::install_signal_handlers()?;
        show("A simulated vehicle tumbles at 500 °/s. Five processes estimate its attitude,".into());
        show(format!("{RATE_HZ} times a second.\n"));
        let mut system = SystemUnderTest::start(&self.name, &self.launch_text(), None, 2 * RATE_HZ as usize)?;
        let address = if self.has_cockpit { system.wait_for_cockpit()? } else { None };
        if let Some(address) = &address {
            show(format!("Watch it in a browser: {address}\n"));
        }
        show("1. A tumble through both charts of the stereographic projection".into());
        tumble(&mut system, show)?;

        show("\n2. Killed services".into());
        for service in [Service::Fuser, Service::Course] {
            kill(&mut system, service, show)?;
        }

        show("\n3. Swaps in motion".into());
        for stage in ["vqf", "multiple-model"] {
            swap(&mut system, &self.name, stage, show)?;
        }
        kill(&mut system, Service::Fuser, show)?;

        show("\n4. Has the output noticed?".into());
        let report = compare(&system)?;
        show(report.to_string());

        if self.stops {
            system.interrupt();
            system.wait_for_end(SHUTDOWN_TIMEOUT)?;
            return Ok(report);
        }
        show("\nThe system runs until Ctrl-C.".into());
        if let Some(address) = address {
            show(format!("Cockpit: {address}"));
        }
        show("Try in another terminal:".into());
        let selection =
            if self.name == Launch::default().name { String::new() } else { format!(" --system {}", self.name) };
        show(format!("  plumb top{selection}"));
        show(format!("  plumb swap fuser wz{selection}"));
        show("  plumb stage list".into());
        while !supervisor::is_stop_requested() && system.poll().is_ok() {
            system.clear_outputs();
            std::thread::sleep(Duration::from_millis(20));
        }
        system.interrupt();
        system.wait_for_end(SHUTDOWN_TIMEOUT)?;
        Ok(report)
    }

    /// Returns the text of the launch file.
    fn launch_text(&self) -> String {
        let cockpit = self.has_cockpit.then_some(Service::Cockpit);
        let services: Vec<_> = Service::PATH.into_iter().chain(cockpit).collect();
        launch_text(&self.name, &services, RATE_HZ as u32) + "scenario = \"tumble\"\n"
    }
}

/// Shows the attitude once a second.
fn tumble(system: &mut SystemUnderTest, show: &mut dyn FnMut(String)) -> Result<(), CampaignError> {
    let start_ns = monotonic_ns();
    for second in 1..=TUMBLE_S {
        system.poll_until(start_ns + second * 1_000_000_000)?;
        let Some((output, point)) = system.outputs().last().and_then(|output| Some((output, up_point(output)?))) else {
            continue;
        };
        let [roll, pitch, yaw] = [output.roll_rad, output.pitch_rad, output.yaw_rad].map(f64::to_degrees);
        let chart = format!("{:?}", point.chart).to_lowercase();
        show(format!(
            "   roll {roll:>+7.1}°  pitch {pitch:>+6.1}°  yaw {yaw:>+7.1}°   {chart:>8} chart, |w| = {:.2}",
            point.w.norm_sqr().sqrt()
        ));
    }
    let points: Vec<_> = system.outputs().iter().filter_map(up_point).collect();
    let changes = points.windows(2).filter(|pair| pair[0].chart != pair[1].chart).count();
    let largest = points.iter().map(|point| point.w.norm_sqr().sqrt()).fold(0.0, f64::max);
    show(format!("   {} of the chart; largest |w|: {largest:.3}.", pluralize(changes as u64, "change")));
    Ok(())
}

/// Returns the up direction in body axes as a point of a chart.
fn up_point(output: &AttitudeOutput) -> Option<Point> {
    Point::from_direction(attitude(output.quaternion).inverse() * Vector3::z())
}

fn attitude([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
}

/// Kills a service and shows the time from the kill to the first attitude of a later sample.
fn kill(system: &mut SystemUnderTest, service: Service, show: &mut dyn FnMut(String)) -> Result<(), CampaignError> {
    let next_tick = system.next_tick();
    let Some(at_ns) = system.kill(service) else {
        return Ok(());
    };
    show(format!("   kill -9 {}", service.name()));
    system.poll_until(at_ns + PAUSE_NS)?;
    let is_new = |output: &&AttitudeOutput| output.header.tick >= next_tick && output.header.t_sent_ns > at_ns;
    if let Some(output) = system.outputs().iter().find(is_new) {
        let recovery_ms = (output.header.t_sent_ns - at_ns) as f64 * 1e-6;
        show(format!("   restarted from its checkpoint; the next attitude came after {recovery_ms:.0} ms"));
    }
    Ok(())
}

/// Swaps the stage of the fuser.
fn swap(system: &mut SystemUnderTest, name: &str, to: &str, show: &mut dyn FnMut(String)) -> Result<(), CampaignError> {
    show(format!("   plumb swap fuser {to}"));
    for _ in 0..MAX_SWAPS {
        let stage = StageConfig { stage: to.into(), set: Default::default() };
        let timeout_ms = Some(SwapRequest::DEFAULT_TIMEOUT_MS);
        let request = SwapRequest { slot: "fuser".into(), stage, shadow: false, expected_epoch: None, timeout_ms };
        let SwapReport { outcome, commit_tick, gap_us, jump_deg, reason, .. } = run_swap(system, name, request)?;
        if let (SwapOutcome::Committed, Some(tick)) = (outcome, commit_tick) {
            let gap_ms = gap_us * 1e-3;
            show(format!(
                "   from tick {tick} on: longest interval between attitudes {gap_ms:.1} ms, jump {jump_deg:.3}°"
            ));
            break;
        }
        let reason = reason.map(|reason| reason.to_string()).unwrap_or_default();
        show(format!("   not committed: {reason}"));
    }
    system.poll_until(monotonic_ns() + PAUSE_NS)
}

/// Computes the attitudes in this process, without kills but with the same swaps, and compares them
/// with the observed attitudes.
fn compare(system: &SystemUnderTest) -> Result<DemoReport, CampaignError> {
    let outputs = system.outputs();
    let next_tick = outputs.first().map_or(0, |output| output.header.tick);
    // A restarted service repeats attitudes that its predecessor may not have published. Only the
    // first copy of each attitude is compared.
    let mut sequence = Sequence { next_tick, ..Sequence::default() };
    let observed: Vec<_> = outputs.iter().filter(|output| sequence.admit(&output.header).is_some()).collect();
    let ticks = observed.len() as u64;
    let mut observed = observed.into_iter().peekable();
    let (mut different, mut accuracy) = (0, Accuracy::default());
    let schedule = Schedule::from_events(system.events());
    compute_undisturbed(system.launch_file(), sequence.next_tick, &schedule, &mut |expected, truth| {
        accuracy.add(AttitudeError::between(*attitude(expected.quaternion), *truth));
        if let Some(output) = observed.next_if(|output| output.header.tick == expected.header.tick) {
            different += u64::from(bytes_of(&output.canonical()) != bytes_of(&expected.canonical()));
        }
    })?;
    different += observed.count() as u64;
    let inclination_rmse_deg = accuracy.rmse().map_or(f64::NAN, |rmse| rmse.inclination_deg);
    Ok(DemoReport { ticks, lost: sequence.lost, different, inclination_rmse_deg })
}

/// Passes the estimated and the true attitude of each tick to `handle`.
fn compute_undisturbed(
    launch: PathBuf,
    max_ticks: u64,
    schedule: &Schedule,
    handle: &mut dyn FnMut(AttitudeOutput, UnitQuaternion<f64>),
) -> Result<(), CampaignError> {
    let request = Request { launch: Some(launch), pace: Some(Pace::Max), in_process: true, ..Request::default() };
    let plan = Plan::new(&request)?;
    let mut conditioner = readings::conditioner(&plan.config).map_err(UpError::from)?;
    let mut path = Path::with_schedule(&plan.config, schedule).map_err(UpError::from)?;
    for reading in Readings::open(&plan.config.launch).map_err(UpError::from)? {
        let Some(mut sample) = conditioner.condition(&reading.map_err(UpError::from)?) else { continue };
        sample.imu.header.epoch = FIRST_EPOCH;
        let truth = sample.reference.map(|truth| attitude(truth.quaternion)).unwrap_or_default();
        path.offer(sample, &mut |output| handle(output, truth)).map_err(UpError::from)?;
        if conditioner.ticks() >= max_ticks || supervisor::is_stop_requested() {
            break;
        }
    }
    Ok(())
}
