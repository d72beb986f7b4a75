//! The services as processes: started, watched, started again, ended, and reaped.

mod post;
mod process;

use std::{
    os::unix::process::ExitStatusExt,
    process::ExitStatus,
    time::{Duration, Instant},
};

use bus::{MORE_MEMORY, SharedMemory};
use launch::{OnLimit, Restart, Service};
use messages::Health;
use runtime::{Orders, Role, orders::Resume, service::FIRST_EPOCH};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::Signal,
};

pub(crate) use post::Post;
pub use post::Standing;
pub(crate) use process::own_cpu_s;
use process::{Process, cpu_s};

use crate::{
    UpError,
    lives::Verdict,
    memory::Memory,
    urgency::{self, Urgency},
};

/// From the first request to end until a process is killed.
const GRACE: Duration = Duration::from_millis(800);
/// When the supervisor itself did not run for so long, nobody's silence in that time counts: the machine stood still, or was taken away.
const STANDSTILL: Duration = Duration::from_millis(100);

/// The services of a system, in the order of [`Service::ALL`].
#[derive(Debug)]
pub(crate) struct Crew {
    posts: [Post; Service::ALL.len()],
    orders: Orders,
    /// Lives given out.
    incarnations: u32,
    /// When the services were looked after last.
    tended: Instant,
}

/// What has happened to the services.
#[derive(Debug, Default)]
pub(crate) struct News {
    /// For people.
    pub(crate) lines: Vec<String>,
    pub(crate) deaths: Vec<Death>,
    /// Lives that follow a death.
    pub(crate) births: Vec<(Service, u32)>,
    /// Services that are not started again.
    pub(crate) away: Vec<Service>,
}

/// A life that has ended.
#[derive(Debug)]
pub(crate) struct Death {
    pub(crate) service: Service,
    pub(crate) incarnation: u32,
    /// Its last words.
    pub(crate) said: String,
}

impl Crew {
    /// Starts every service in the order of the launch file.
    pub(crate) fn start(orders: &Orders) -> Result<Self, UpError> {
        let mut crew =
            Self { posts: Default::default(), orders: orders.clone(), incarnations: 0, tended: Instant::now() };
        for service in orders.launch.services.clone() {
            crew.begin(service, None)?;
        }
        Ok(crew)
    }

    pub(crate) fn post(&self, service: Service) -> &Post {
        &self.posts[service as usize]
    }

    /// Those that are to run.
    pub(crate) fn posts(&self) -> impl Iterator<Item = (Service, &Post)> {
        let runs = |(service, _): &(Service, &Post)| self.orders.launch.services.contains(service);
        Service::ALL.into_iter().zip(&self.posts).filter(runs)
    }

    /// Those that every tick passes through: of the data path, and the gateway of a split system.
    pub(crate) fn path(&self) -> impl Iterator<Item = (Service, &Post)> {
        self.posts().filter(|(service, _)| self.orders.launch.follows(*service))
    }

    /// A service has said where it can be reached.
    pub(crate) fn found(&mut self, service: &str, at: String) {
        if let Some(service) = Service::named(service) {
            self.posts[service as usize].at = Some(at);
        }
    }

    /// Takes what a service says of itself; the last words of the dead are left out.
    pub(crate) fn hear(&mut self, health: Health) {
        let Some(post) = self.posts.get_mut(health.service as usize) else { return };
        if let Some(owner) = post.process.iter().find(|it| it.incarnation == health.incarnation && it.heard.is_none()) {
            post.lives.spoke(owner.since.elapsed());
        }
        let lives = [&mut post.process, &mut post.candidate, &mut post.retired];
        for process in lives.into_iter().flatten().filter(|process| process.incarnation == health.incarnation) {
            process.heard = Some(health);
            (process.quiet_since, process.forgiven) = (Instant::now(), false);
        }
    }

    /// Starts a stage beside the one that fills the slot, or in the place of one that has ended; a candidate that is still there is killed.
    pub(crate) fn begin_candidate(
        &mut self,
        service: Service,
        stage: launch::Stage,
        epoch: u32,
        role: Role,
        resume: Resume,
    ) -> Result<u32, UpError> {
        self.incarnations += 1;
        let incarnation = self.incarnations;
        let mut orders = Orders { incarnation, epoch, role, resume: Some(resume), ..self.orders.clone() };
        if let Some(slot) = orders.launch.slot_mut(service) {
            *slot = stage;
        }
        let post = &mut self.posts[service as usize];
        if let Some(before) = post.candidate.take() {
            before.signal(Signal::KILL);
            post.retired = Some(before);
        }
        let process = Process::start(service, &orders)?;
        urgency::set(process.pid, if process.owns { Urgency::Path } else { Urgency::Starting });
        post.candidate = Some(process);
        Ok(incarnation)
    }

    /// The candidate is to be on the path.
    pub(crate) fn hasten_candidate(&self, service: Service) {
        self.post(service).candidate.iter().for_each(|process| urgency::set(process.pid, Urgency::Path));
    }

    /// The candidate fills the slot; later lives are of its stage.
    pub(crate) fn promote(&mut self, service: Service, stage: launch::Stage) {
        let post = &mut self.posts[service as usize];
        if let Some(before) = std::mem::replace(&mut post.process, post.candidate.take()) {
            post.retired = Some(before);
        }
        (post.away, post.due) = (false, None);
        post.lives.begin_anew();
        if let Some(slot) = self.orders.launch.slot_mut(service) {
            *slot = stage;
        }
    }

    /// Whether this life is to take over.
    pub(crate) fn is_candidate(&self, service: u32, incarnation: u32) -> bool {
        let post = self.posts.get(service as usize);
        post.and_then(|post| post.candidate.as_ref()).is_some_and(|candidate| candidate.incarnation == incarnation)
    }

    /// Ends a life that does not own its slot; one that does not go is killed when it is asked again.
    pub(crate) fn dismiss(&mut self, service: Service, incarnation: u32) {
        let post = &mut self.posts[service as usize];
        let lives = [&mut post.process, &mut post.candidate, &mut post.retired];
        for process in lives.into_iter().flatten().filter(|process| process.incarnation == incarnation) {
            urgency::set(process.pid, Urgency::Leaving);
            process.signal(if process.asked { Signal::KILL } else { Signal::TERM });
            process.asked = true;
        }
    }

    /// Kills every process: its bus is no more. What is known of the services stays.
    pub(crate) fn leave_bus(&mut self) {
        for post in &mut self.posts {
            let lives = [post.process.take(), post.candidate.take(), post.retired.take()];
            lives.into_iter().flatten().for_each(|mut process| process.kill());
            (post.due, post.term, post.at, post.ending) = (None, None, None, false);
        }
    }

    /// Starts every service that has not failed from its checkpoint, on another bus.
    pub(crate) fn start_anew(&mut self, memory: &Memory) -> Result<(), UpError> {
        self.tended = Instant::now();
        for service in self.orders.launch.services.clone() {
            if !self.post(service).away {
                self.begin(service, Some(memory.resume(service, &self.orders.launch)))?;
            }
        }
        Ok(())
    }

    /// The processes that fill the slots.
    pub(crate) fn pids(&self) -> Vec<u32> {
        self.path().map(|(_, post)| post.pid()).filter(|pid| *pid != 0).collect()
    }

    /// Somebody is to be started again.
    pub(crate) fn lacks_somebody(&self) -> bool {
        self.posts.iter().any(|post| post.due.is_some())
    }

    /// Services that are not started again.
    pub(crate) fn away(&self) -> Vec<Service> {
        self.posts().filter(|(_, post)| post.away).map(|(service, _)| service).collect()
    }

    /// The owner of the slot is to begin anew from its checkpoint.
    pub(crate) fn begin_anew(&self, service: Service) {
        self.post(service).process.iter().for_each(|process| process.signal(Signal::KILL));
    }

    /// The decision under which the slot's next life begins.
    pub(crate) fn under(&mut self, service: Service, epoch: u32, from_tick: u64) {
        self.posts[service as usize].term = Some((epoch, from_tick));
    }

    /// Sees who has ended, and kills who says nothing any more.
    pub(crate) fn tend(&mut self, news: &mut News) -> Result<(), UpError> {
        let rule = self.orders.launch.restart;
        let stood_still = std::mem::replace(&mut self.tended, Instant::now()).elapsed();
        for service in Service::ALL {
            let post = &mut self.posts[service as usize];
            if stood_still > STANDSTILL {
                post.forgive(stood_still);
            }
            post.kill_the_silent(service, &rule, news);
            for life in [&mut post.candidate, &mut post.retired] {
                if let Some(mut gone) = life.take_if(|process| process.reap().is_some()) {
                    let said = gone.said.text();
                    if !said.is_empty() {
                        news.lines.push(format!("{service}: process {} said:\n{said}", gone.pid));
                    }
                    news.deaths.push(Death { service, incarnation: gone.incarnation, said });
                }
            }
            let ended = post.process.as_mut().and_then(Process::reap);
            if let Some(status) = ended.filter(|_| !post.ending) {
                self.bury(service, status, news)?;
            }
        }
        Ok(())
    }

    /// Starts again who is to be.
    pub(crate) fn revive(&mut self, memory: &Memory, news: &mut News) -> Result<(), UpError> {
        for service in Service::ALL {
            let post = &self.posts[service as usize];
            if !post.ending && !post.is_replaced() && post.due.is_some_and(|due| Instant::now() >= due) {
                let incarnation = match self.begin(service, Some(memory.resume(service, &self.orders.launch))) {
                    Err(error) if service.is_beside() => {
                        let longest = Duration::from_secs_f64(self.orders.launch.restart.backoff_max_s);
                        self.posts[service as usize].due = Some(Instant::now() + longest);
                        news.lines.push(format!("{service}: {error}; again in {} s", longest.as_secs()));
                        continue;
                    }
                    begun => begun?,
                };
                news.births.push((service, incarnation));
                let post = &self.posts[service as usize];
                news.lines.push(format!("{service}: process {} goes on, restart {}", post.pid(), post.lives.restarts));
            }
        }
        Ok(())
    }

    /// A life has ended, and the rule says what comes of it.
    fn bury(&mut self, service: Service, status: ExitStatus, news: &mut News) -> Result<(), UpError> {
        let post = &mut self.posts[service as usize];
        let Some(mut process) = post.process.take() else { return Ok(()) };
        let how = match (status.code(), status.signal()) {
            (Some(0), _) => "ended with code 0, as if somebody else had sent it SIGTERM".into(),
            (Some(code), _) => format!("ended with code {code}"),
            (None, Some(libc::SIGBUS)) => {
                format!("found no memory for its part of the bus (signal 7): {}", memory_state())
            }
            (None, Some(signal)) => format!("was ended by signal {signal}"),
            (None, None) => "ended".into(),
        };
        let said = process.said.text();
        news.deaths.push(Death { service, incarnation: process.incarnation, said: said.clone() });
        let said = if said.is_empty() { said } else { format!(":\n{said}") };
        post.at = None;
        let rule = self.orders.launch.restart;
        let on_limit = if service.is_beside() { OnLimit::Hold } else { rule.on_limit };
        let rule = Restart { on_limit, ..rule };
        let verdict = match process.heard {
            None if process.given_up && post.lives.restarts == 0 => post.lives.never_began(&rule),
            heard => post.lives.ended(heard.map(|_| process.since.elapsed()), &rule),
        };
        match verdict {
            Verdict::Stop => return Err(UpError::ServiceEnded { service, pid: process.pid, how, said }),
            Verdict::Away => {
                post.away = true;
                news.away.push(service);
                let remedy = remedy(service);
                news.lines.push(format!(
                    "{service}: process {} {how}; it has failed and stays away{remedy}{said}",
                    process.pid
                ));
            }
            Verdict::Again(pause) => {
                post.due = Some(Instant::now() + pause);
                let when = if pause.is_zero() { String::new() } else { format!(", again in {} ms", pause.as_millis()) };
                let remedy = if post.lives.has_failed(&rule) { remedy(service) } else { String::new() };
                news.lines.push(format!("{service}: process {} {how}{when}{remedy}{said}", process.pid));
            }
        }
        Ok(())
    }

    /// The next life of a service.
    fn begin(&mut self, service: Service, resume: Option<Resume>) -> Result<u32, UpError> {
        self.incarnations += 1;
        let again = resume.is_some();
        let post = &mut self.posts[service as usize];
        let (epoch, from_tick) = post.term.unwrap_or((FIRST_EPOCH, 0));
        let role = Role::Owner { from_tick };
        let orders = Orders { incarnation: self.incarnations, epoch, role, resume, ..self.orders.clone() };
        let process = Process::start(service, &orders)?;
        urgency::set(process.pid, if service.is_beside() { Urgency::Beside } else { Urgency::Path });
        post.process = Some(process);
        post.due = None;
        post.lives.restarts += u32::from(again);
        Ok(self.incarnations)
    }

    /// What the next life of a service is told.
    pub(crate) fn orders(&self) -> &Orders {
        &self.orders
    }

    /// How the services are.
    pub(crate) fn ps(&self) -> Vec<Standing> {
        let silence = Duration::from_secs_f64(self.orders.launch.restart.silence_s);
        let standing = |(service, post): (Service, &Post)| Standing {
            service: service.name().into(),
            stage: self.orders.launch.slot(service).map(|slot| slot.stage.clone()),
            state: post.standing(silence).into(),
            pid: post.pid(),
            restarts: post.restarts(),
            incarnation: post.incarnation(),
            epoch: post.heard().map_or(0, |health| health.epoch),
            ticks: post.heard().map_or(0, |health| health.ticks),
            lost: post.heard().map_or(0, |health| health.lost),
            at: post.at.clone(),
        };
        self.posts().map(standing).collect()
    }

    /// Sleeps until a process ends, no longer than `limit`.
    pub(crate) fn wait(&self, limit: Duration) {
        let lives = self.posts.iter().flat_map(|post| [&post.process, &post.candidate, &post.retired]);
        let fds = lives.filter_map(|process| process.as_ref()?.fd.as_ref());
        let mut fds: Vec<_> = fds.map(|fd| PollFd::new(fd, PollFlags::IN)).collect();
        let limit = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
        // A signal ends it too: the caller looks again.
        let _ = poll(&mut fds, Some(&limit));
    }

    /// Asks one service to end; it is not started again.
    pub(crate) fn ask_to_end(&mut self, service: Service) {
        self.posts[service as usize].ending = true;
        self.post(service).process.iter().for_each(|process| process.signal(Signal::TERM));
    }

    /// Ends every process and reaps it.
    pub(crate) fn end(&mut self) {
        let deadline = Instant::now() + GRACE;
        let lives = |post: &'_ mut Post| [post.process.take(), post.candidate.take(), post.retired.take()];
        let mut processes: Vec<_> = self.posts.iter_mut().flat_map(lives).flatten().collect();
        processes.iter().for_each(|process| process.signal(Signal::TERM));
        while processes.iter_mut().any(|process| process.reap().is_none()) && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(2));
        }
        for process in &mut processes {
            if process.reap().is_none() {
                process.kill();
            }
        }
    }

    /// CPU time of all processes since they started, s.
    pub(crate) fn cpu_s(&self) -> f64 {
        let living = self.posts.iter().filter_map(|post| post.process.as_ref());
        living.map(|process| cpu_s(&process.pid.to_string())).sum::<f64>()
    }
}

/// How much shared memory there is, and how to have more.
fn memory_state() -> String {
    let state = SharedMemory::now().map_or(String::new(), |memory| format!("{memory}; "));
    format!("{state}{MORE_MEMORY}")
}

/// What can be done about a service that has failed.
fn remedy(service: Service) -> String {
    let is_slot = Service::SLOTS.contains(&service);
    if is_slot { format!("; `plumb swap {service} STAGE` puts another stage in its place") } else { String::new() }
}

impl Drop for Crew {
    fn drop(&mut self) {
        self.end();
    }
}
