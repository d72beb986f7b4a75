//! What the gateway is asked: last values, the schema, how the services are, and swaps.

use std::{
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use link::{Answering, Link, LinkError, Question};
use runtime::clock::monotonic_ns;
use supervisor::Ask;
use wire::{
    command::Letter,
    keys, schema,
    v1::{Services, Standing, SwapAnswer, SwapRequest},
};

use crate::{Shared, locked, sender::Last};

/// Questions that take time, at once.
const CLERKS_MAX: usize = 8;

/// Questions that are being seen to.
pub(crate) type Clerks = Arc<AtomicUsize>;

/// Answers until the result is dropped.
pub(crate) fn open(link: &Link, shared: &Arc<Shared>, system: &str, last: Last) -> Result<[Answering; 2], LinkError> {
    let clerks = Clerks::default();
    let vehicle = shared.vehicle.clone();
    let looking = link.answering(&keys::key(&vehicle, "*"), {
        let (system, clerks) = (system.to_owned(), clerks.clone());
        move |question| look(question, &vehicle, &last, &system, &clerks)
    })?;
    let key = keys::key(&shared.vehicle, keys::SWAP);
    let commands = link.answering(&key.clone(), {
        let shared = shared.clone();
        move |question| swap(question, &key, &shared, &clerks)
    })?;
    Ok([looking, commands])
}

fn look(question: Question, vehicle: &str, last: &Last, system: &str, clerks: &Clerks) {
    // An answer may have to wait for its reader; the sender must not wait for `last` meanwhile.
    let last: Vec<_> = locked(last).iter().filter(|(key, _)| question.is_about(key)).map(own).collect();
    for (key, (message, bytes)) in last {
        question.answer(&key, &message, bytes);
    }
    let key = keys::key(vehicle, keys::SCHEMA);
    if question.is_about(&key) {
        question.answer(&key, schema::DESCRIPTORS_NAME, schema::DESCRIPTORS.to_vec());
    }
    let key = keys::key(vehicle, keys::SERVICES);
    if question.is_about(&key) {
        let system = system.to_owned();
        with_a_clerk(clerks, question, move |question| {
            match supervisor::ask::<Vec<supervisor::Standing>>(&system, &Ask::Ps) {
                Ok(standings) => {
                    let services = standings.into_iter().map(standing).collect();
                    let services = Services { t_now_ns: monotonic_ns(), services };
                    question.answer(&key, &format!("plumbline.v1.{}", Services::NAME), services.encoded());
                }
                Err(error) => question.refuse(&error.to_string()),
            }
        });
    }
}

fn own<K: Clone, V: Clone>((key, value): (&K, &V)) -> (K, V) {
    (key.clone(), value.clone())
}

fn swap(question: Question, key: &str, shared: &Arc<Shared>, clerks: &Clerks) {
    let request = match SwapRequest::decoded(&question.payload()) {
        Ok(request) => request,
        Err(refusal) => {
            locked(&shared.refusals).count(&refusal);
            return question.refuse(&refusal.to_string());
        }
    };
    let (desk, key) = (shared.desk.clone(), key.to_owned());
    with_a_clerk(clerks, question, move |question| {
        let answer = desk.answer(request);
        question.answer(&key, &format!("plumbline.v1.{}", SwapAnswer::NAME), answer.encoded());
    });
}

/// Sees to a question that takes time on a thread of its own; beyond the limit it is refused.
pub(crate) fn with_a_clerk(clerks: &Clerks, question: Question, see_to: impl FnOnce(Question) + Send + 'static) {
    if clerks.fetch_add(1, Ordering::SeqCst) >= CLERKS_MAX {
        clerks.fetch_sub(1, Ordering::SeqCst);
        return question.refuse("too many questions at once; ask again");
    }
    let clerks = clerks.clone();
    thread::spawn(move || {
        see_to(question);
        clerks.fetch_sub(1, Ordering::SeqCst);
    });
}

fn standing(of: supervisor::Standing) -> Standing {
    let supervisor::Standing { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at } = of;
    let (stage, at) = (stage.unwrap_or_default(), at.unwrap_or_default());
    Standing { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at }
}
