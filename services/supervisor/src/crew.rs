//! The services as processes: started, watched, started again, ended, and reaped.

use std::{
    io::{self, Read, Write},
    os::{fd::OwnedFd, unix::process::CommandExt, unix::process::ExitStatusExt},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use launch::{Restart, Service};
use messages::{Health, State};
use runtime::{Orders, orders::Resume};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open},
};

use crate::{
    UpError,
    lives::{Lives, Verdict},
    memory::Memory,
};

/// From the first request to end until a process is killed.
const GRACE: Duration = Duration::from_millis(400);
/// From a start until the service must be ready.
pub(crate) const READY_LIMIT: Duration = Duration::from_secs(10);
/// What a service says last is kept up to this, bytes.
const SAID_MAX: u64 = 8192;

/// The services of a system, in the order of [`Service::ALL`].
#[derive(Debug)]
pub(crate) struct Crew {
    posts: [Post; Service::ALL.len()],
    orders: Orders,
    /// Lives given out.
    incarnations: u32,
    /// CPU time of the lives that ended, s.
    past_cpu_s: f64,
}

/// A service and its lives.
#[derive(Debug, Default)]
pub(crate) struct Post {
    process: Option<Process>,
    lives: Lives,
    heard: Option<Heard>,
    /// When it is started again.
    due: Option<Instant>,
    /// It is not started again.
    away: bool,
}

/// What a service said last.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Heard {
    pub(crate) health: Health,
    pub(crate) at: Instant,
}

/// One life.
#[derive(Debug)]
struct Process {
    pid: u32,
    child: Child,
    fd: Option<OwnedFd>,
    since: Instant,
    ended: Option<ExitStatus>,
}

impl Crew {
    /// Starts every service in the order of the launch file.
    pub(crate) fn start(orders: &Orders) -> Result<Self, UpError> {
        let mut crew = Self { posts: Default::default(), orders: orders.clone(), incarnations: 0, past_cpu_s: 0.0 };
        for service in orders.launch.services.clone() {
            crew.begin(service, None)?;
        }
        Ok(crew)
    }

    pub(crate) fn post(&self, service: Service) -> &Post {
        &self.posts[service as usize]
    }

    pub(crate) fn posts(&self) -> impl Iterator<Item = (Service, &Post)> {
        Service::ALL.into_iter().zip(&self.posts)
    }

    /// Takes what a service says of itself; an earlier life's last words are left out.
    pub(crate) fn hear(&mut self, health: Health) {
        let Some(post) = self.posts.get_mut(health.service as usize) else { return };
        if post.process.as_ref().is_some_and(|process| process.pid == health.pid) {
            post.heard = Some(Heard { health, at: Instant::now() });
        }
    }

    /// Sees to every service: whoever has ended, or says nothing any more, is started again as the rule has it. `expected` services may end.
    pub(crate) fn tend(
        &mut self,
        memory: &Memory,
        expected: &[Service],
        news: &mut Vec<String>,
    ) -> Result<(), UpError> {
        let rule = self.orders.launch.restart;
        for service in Service::ALL {
            let post = &mut self.posts[service as usize];
            post.kill_the_silent(service, &rule, news);
            let ended = post.process.as_mut().and_then(|process| Some((process.reap()?, process.since.elapsed())));
            if let Some((status, lived)) = ended {
                if expected.contains(&service) && status.success() {
                    continue;
                }
                self.bury(service, status, lived, news)?;
            }
            if self.posts[service as usize].due.is_some_and(|due| Instant::now() >= due) {
                self.begin(service, Some(memory.resume(service)))?;
                let post = &self.posts[service as usize];
                news.push(format!("{service}: process {} goes on, restart {}", post.pid(), post.lives.restarts));
            }
        }
        Ok(())
    }

    /// A life has ended, and the rule says what comes of it.
    fn bury(
        &mut self,
        service: Service,
        status: ExitStatus,
        lived: Duration,
        news: &mut Vec<String>,
    ) -> Result<(), UpError> {
        let post = &mut self.posts[service as usize];
        let Some(mut process) = post.process.take() else { return Ok(()) };
        post.heard = None;
        let how = match (status.code(), status.signal()) {
            (Some(code), _) => format!("ended with code {code}"),
            (None, Some(signal)) => format!("was ended by signal {signal}"),
            (None, None) => "ended".into(),
        };
        let said = process.said();
        let said = if said.is_empty() { said } else { format!(":\n{said}") };
        match post.lives.ended(lived, &self.orders.launch.restart) {
            Verdict::Stop => return Err(UpError::ServiceEnded { service, pid: process.pid, how, said }),
            Verdict::Away => {
                post.away = true;
                news.push(format!("{service}: process {} {how}; it has failed and stays away{said}", process.pid));
            }
            Verdict::Again(pause) => {
                post.due = Some(Instant::now() + pause);
                let when = if pause.is_zero() { String::new() } else { format!(", again in {} ms", pause.as_millis()) };
                news.push(format!("{service}: process {} {how}{when}{said}", process.pid));
            }
        }
        Ok(())
    }

    /// The next life of a service.
    fn begin(&mut self, service: Service, resume: Option<Resume>) -> Result<(), UpError> {
        self.incarnations += 1;
        let again = resume.is_some();
        let orders = Orders { incarnation: self.incarnations, resume, ..self.orders.clone() };
        let process = Process::start(service, &orders)
            .map_err(|cause| UpError::System { doing: format!("starting the service {service}"), cause })?;
        let post = &mut self.posts[service as usize];
        post.process = Some(process);
        post.due = None;
        post.lives.restarts += u32::from(again);
        Ok(())
    }

    /// Sleeps until a process ends, no longer than `limit`.
    pub(crate) fn wait(&self, limit: Duration) {
        let fds = self.posts.iter().filter_map(|post| post.process.as_ref()?.fd.as_ref());
        let mut fds: Vec<_> = fds.map(|fd| PollFd::new(fd, PollFlags::IN)).collect();
        let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
        // A signal ends it too: the caller looks again.
        let _ = poll(&mut fds, Some(&limit));
    }

    /// Asks one service to end.
    pub(crate) fn ask_to_end(&self, service: Service) {
        self.post(service).process.iter().for_each(|process| process.signal(Signal::TERM));
    }

    /// Ends every process and reaps it.
    pub(crate) fn end(&mut self) {
        let deadline = Instant::now() + GRACE;
        let mut processes: Vec<_> = self.posts.iter_mut().filter_map(|post| post.process.as_mut()).collect();
        processes.iter().for_each(|process| process.signal(Signal::TERM));
        while processes.iter_mut().any(|process| process.reap().is_none()) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        for process in processes {
            if process.reap().is_none() {
                process.signal(Signal::KILL);
                // A killed process ends; the wait is for the kernel only.
                process.ended = process.child.wait().ok();
            }
        }
    }

    /// CPU time of all processes since they started, s.
    pub(crate) fn cpu_s(&self) -> f64 {
        let living = self.posts.iter().filter_map(|post| post.process.as_ref());
        self.past_cpu_s + living.map(|process| cpu_s(&process.pid.to_string())).sum::<f64>()
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        self.end();
    }
}

impl Post {
    /// What it said last.
    pub(crate) fn heard(&self) -> Option<&Heard> {
        self.heard.as_ref()
    }

    /// Its process; 0 where there is none.
    pub(crate) fn pid(&self) -> u32 {
        self.process.as_ref().map_or(0, |process| process.pid)
    }

    /// Times it was started again.
    pub(crate) fn restarts(&self) -> u32 {
        self.lives.restarts
    }

    /// What it does, in a word.
    pub(crate) fn standing(&self, silence: Duration) -> &'static str {
        match (&self.process, &self.heard) {
            _ if self.away => "failed",
            (None, _) => "backoff",
            (Some(_), None) => "starting",
            (Some(_), Some(heard)) if heard.at.elapsed() > silence => "silent",
            (Some(_), Some(heard)) => State::name(heard.health.state),
        }
    }

    /// It has opened its topics, or will not any more.
    pub(crate) fn is_settled(&self) -> bool {
        self.away || self.heard.is_some()
    }

    fn kill_the_silent(&self, service: Service, rule: &Restart, news: &mut Vec<String>) {
        let Some(process) = &self.process else { return };
        let (silent, limit) = match &self.heard {
            Some(heard) => (heard.at.elapsed(), Duration::from_secs_f64(rule.silence_s)),
            None => (process.since.elapsed(), READY_LIMIT),
        };
        if silent > limit && process.ended.is_none() {
            news.push(format!("{service}: process {} has said nothing for {} ms", process.pid, silent.as_millis()));
            process.signal(Signal::KILL);
        }
    }
}

impl Process {
    fn start(service: Service, orders: &Orders) -> io::Result<Self> {
        let text = serde_json::to_vec(&orders)?;
        let mut child = Command::new(std::env::current_exe()?)
            .args(["service", service.name()])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Ctrl-C is for the supervisor, which ends the services in their order.
            .process_group(0)
            .spawn()?;
        let stdin = child.stdin.take();
        let pid = child.id();
        let fd = Pid::from_raw(pid as i32).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
        let process = Self { pid, child, fd, since: Instant::now(), ended: None };
        // One that has ended before it read its orders is found when it is reaped.
        stdin.map_or(Ok(()), |mut stdin| stdin.write_all(&text)).or_else(|cause| match cause.kind() {
            io::ErrorKind::BrokenPipe => Ok(()),
            _ => Err(cause),
        })?;
        Ok(process)
    }

    fn reap(&mut self) -> Option<ExitStatus> {
        if self.ended.is_none() {
            self.ended = self.child.try_wait().ok().flatten();
        }
        self.ended
    }

    fn signal(&self, signal: Signal) {
        if self.ended.is_some() {
            return;
        }
        if let Some(pid) = Pid::from_raw(self.pid as i32) {
            // A process that has just ended does not need the signal.
            let _ = kill_process(pid, signal);
        }
    }

    /// What an ended service said last.
    fn said(&mut self) -> String {
        let mut said = Vec::new();
        if let Some(stderr) = self.child.stderr.take() {
            // What cannot be read cannot be shown; the exit status is.
            let _ = stderr.take(SAID_MAX).read_to_end(&mut said);
        }
        String::from_utf8_lossy(&said).trim_end().to_owned()
    }
}

/// CPU time of this process, s.
pub(crate) fn own_cpu_s() -> f64 {
    cpu_s("self")
}

/// CPU time of a process of one thread, s; 0 when it is no more.
fn cpu_s(process: &str) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/schedstat")).unwrap_or_default();
    text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}
