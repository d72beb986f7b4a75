//! The loop of a service over the bus.

use bus::{BusError, Publisher, Subscriber};
use messages::{Checkpoint, Control, Flags, Health, State, Ticked};
use swap::{Standing, Tenure};

use crate::{
    Member, RuntimeError,
    checkpoint::{self, ResumeError, Resumed},
    clock::monotonic_ns,
    orders::{BUFFER_BESIDE, Orders, Resume, Role},
    reader::Input,
    shadow::{Comparable, Shadowing},
    slot::{Sequence, Slot},
};

/// The supervisor's first decision: every slot belongs to whom `launch.toml` names.
pub const FIRST_EPOCH: u32 = 1;
/// Messages of one input taken before the others have their turn: a join must not think that one of them is silent.
const TURN: usize = 32;
/// However much there is to do, after so long a service says how it is and looks at the decisions.
const TURN_LIMIT_NS: u64 = 50_000_000;

/// Runs a slot until the service is to end. `inputs` are in the slot's own order.
pub fn serve<S: Slot + Clone>(
    member: Member,
    mut slot: S,
    inputs: &[&dyn Input<S::Input>],
) -> Result<(), RuntimeError> {
    let mut resumed = None;
    if member.orders.resume.is_some() {
        resumed = resume(&member, &mut slot);
        slot.expect_until(inputs.iter().map(|input| input.next_tick()).max().unwrap_or(0));
    }
    let Orders { incarnation, epoch, role, .. } = member.orders;
    let capacity = member.orders.lateness_ticks() as usize;
    let output: Publisher<S::Output> = member.publisher()?;
    let mut service = Serving {
        exchanged_at: match (role, resumed) {
            (_, Some(Resumed::Whole)) => None,
            (Role::Candidate, _) => Some(0),
            // What comes before has been published by another stage.
            (Role::Owner { .. }, Some(Resumed::Common)) => Some(output.next_tick()),
            (Role::Owner { .. }, None) => None,
        },
        output,
        checkpoints: member.bus.publisher(BUFFER_BESIDE)?,
        control: member.control()?,
        tenure: match role {
            Role::Owner { from_tick } => Tenure::owner(incarnation, epoch, from_tick, capacity),
            Role::Candidate => Tenure::candidate(incarnation, epoch, capacity),
        },
        shadow: match role {
            Role::Owner { .. } => None,
            Role::Candidate => Some(Shadowing::begin(&member)?),
        },
        next_checkpoint: 0,
        flags: Flags::NONE,
        flawed: 0,
        member,
    };
    service.say(&slot, inputs, State::READY)?;
    service.member.bus.wake_all();
    while !service.member.ends() {
        service.turn(&mut slot, inputs)?;
        service.heed()?;
        service.note(&mut slot)?;
        let state = if slot.sequence().ticks > 0 { State::RUNNING } else { State::READY };
        service.say(&slot, inputs, state)?;
        if let Some(lacking) = inputs.get(slot.lacks()) {
            service.member.wait(*lacking);
        }
    }
    Ok(())
}

/// Goes on from what the orders hold. What cannot be taken over is said; the service then begins with what its inputs hold.
fn resume<S: Slot + Clone>(member: &Member, slot: &mut S) -> Option<Resumed> {
    let Some(Resume::Checkpoint(record)) = &member.orders.resume else { return None };
    let resumed = record
        .checkpoint()
        .ok_or(ResumeError::Damaged)
        .and_then(|checkpoint| checkpoint::resume(slot, member.service, &checkpoint));
    match resumed {
        Ok(resumed) => Some(resumed),
        Err(error) => {
            eprintln!("the service {} does not go on from its checkpoint: {error}; it begins anew", member.service);
            None
        }
    }
}

/// A slot's service at work.
struct Serving<O: Ticked + Comparable> {
    member: Member,
    output: Publisher<O>,
    checkpoints: Publisher<Checkpoint>,
    control: Subscriber<Control>,
    tenure: Tenure<O>,
    /// What is published is another stage's than before, up to the first output at this tick or after it.
    exchanged_at: Option<u64>,
    shadow: Option<Shadowing<O>>,
    next_checkpoint: u64,
    flags: Flags,
    flawed: u64,
}

impl<O: Ticked + Comparable> Serving<O> {
    /// Takes what the inputs hold and publishes what follows from it, as far as the slot is owned.
    fn turn<S: Slot<Output = O>>(&mut self, slot: &mut S, inputs: &[&dyn Input<S::Input>]) -> Result<(), RuntimeError> {
        self.output.greet()?;
        let (before, begun_ns) = (slot.sequence().ticks, monotonic_ns());
        let published = self.tenure.publishes();
        let Self { member, output, tenure, exchanged_at, shadow, flags, flawed, .. } = self;
        let mut failed = None;
        for _ in 0..member.orders.buffer_ticks() / TURN + 1 {
            let mut taken = 0;
            for input in inputs {
                input.drain(TURN, &mut |message| {
                    taken += 1;
                    slot.offer(message, &mut |out| {
                        *flags |= out.header().flags;
                        *flawed += u64::from(out.attitude().is_none());
                        shadow.iter_mut().for_each(|shadow| shadow.computed(&out));
                        tenure.take(out, &mut |out| {
                            failed = failed.take().or(publish(output, out, exchanged_at).err());
                        });
                    });
                })?;
            }
            if taken == 0 {
                break;
            }
            if slot.sequence().ticks != before {
                output.wake();
            }
            if monotonic_ns() - begun_ns > TURN_LIMIT_NS {
                break;
            }
        }
        // Whoever takes over is confirmed by that.
        if published && !tenure.publishes() {
            member.say_at_once();
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Follows the decisions about the slot.
    fn heed(&mut self) -> Result<(), RuntimeError> {
        let Self { member, output, control, tenure, exchanged_at, .. } = self;
        let (mut failed, mut decided) = (None, false);
        control.drain(BUFFER_BESIDE, |control| {
            if control.service == member.service as u32 {
                let Control { epoch, owner, from_tick, .. } = control;
                decided |= tenure
                    .decide(swap::Control { epoch, owner, from_tick }, &mut |out| {
                        failed = failed.take().or(publish(output, out, exchanged_at).err());
                    })
                    .is_some();
            }
        })?;
        if decided {
            output.wake();
            member.say_at_once();
        }
        // Who owns the slot is no shadow.
        self.shadow.take_if(|_| tenure.publishes());
        if let Some(shadow) = &mut self.shadow {
            shadow.compare()?;
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// Publishes the state every so many ticks.
    fn note<S: Slot<Output = O>>(&mut self, slot: &mut S) -> Result<(), RuntimeError> {
        let next_tick = slot.sequence().next_tick;
        if next_tick < self.next_checkpoint {
            return Ok(());
        }
        let Member { service, orders, .. } = &self.member;
        self.next_checkpoint = next_tick + orders.checkpoint_ticks();
        Ok(self.checkpoints.send(&checkpoint::checkpoint(slot, *service, orders.incarnation))?)
    }

    fn say<S: Slot>(&mut self, slot: &S, inputs: &[&dyn Input<S::Input>], state: State) -> Result<(), RuntimeError> {
        let Sequence { ticks, lost, mut duplicated, mut repeated, next_tick, .. } = *slot.sequence();
        for input in inputs {
            let [again, said_again] = input.repeated();
            (duplicated, repeated) = (duplicated + again, repeated + said_again);
        }
        let Standing { decided_epoch, missed, published_from, .. } = self.tenure.standing();
        let (flags, flawed) = (self.flags, self.flawed);
        self.member.say(state, |health| {
            *health = Health {
                ticks,
                lost,
                duplicated,
                repeated,
                next_tick,
                flags,
                epoch: decided_epoch,
                missed: missed.into(),
                published_from: published_from.unwrap_or(u64::MAX),
                flawed,
                ..*health
            };
        })
    }
}

/// Sends an output that the service owns.
fn publish<O: Ticked>(output: &Publisher<O>, mut out: O, exchanged_at: &mut Option<u64>) -> Result<(), BusError> {
    let header = out.header_mut();
    header.flags |= Flags::EXCHANGED.when(exchanged_at.is_some());
    exchanged_at.take_if(|tick| header.tick >= *tick);
    header.t_sent_ns = monotonic_ns();
    output.note(header.tick);
    output.send(&out)
}
