//! What the gateway is asked: last values, the schema, how the services are, and swaps.

use std::sync::Arc;

use control::ControlRequest;
use link::{Answering, Link, LinkError, Question};
use runtime::clock::monotonic_ns;
use wire::{
    command::ControlMessage,
    keys, schema,
    v1::{ServiceStatus, Services, SwapAnswer, SwapRequest, Trouble},
};

use crate::{Shared, locked, sender::Last, worker_pool::WorkerPool};

/// Answers until the result is dropped.
pub(crate) fn open(link: &Link, shared: &Arc<Shared>, last: Last) -> Result<[Answering; 2], LinkError> {
    // Who waits for a swap keeps nobody from looking.
    let [lookers, commanders] = [(); 2].map(|()| WorkerPool::new(&shared.turned_away));
    let looking = link.answering(&keys::key(&shared.vehicle, "*"), {
        let shared = shared.clone();
        move |question| {
            let (shared, last) = (shared.clone(), last.clone());
            lookers.see_to(question, move |question| look(question, &shared, &last));
        }
    })?;
    let commands = link.answering(&keys::key(&shared.vehicle, keys::SWAP), {
        let shared = shared.clone();
        move |question| {
            let shared = shared.clone();
            commanders.see_to(question, move |question| swap(question, &shared));
        }
    })?;
    Ok([looking, commands])
}

fn look(question: &Question, shared: &Shared, last: &Last) {
    let Shared { system, vehicle, .. } = shared;
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
        match control::ask::<Vec<control::ServiceStatus>>(system, &ControlRequest::Ps) {
            Ok(statuses) => {
                let services = statuses.into_iter().map(status).collect();
                let services = Services { t_now_ns: monotonic_ns(), services };
                question.answer(&key, &format!("plumbline.v1.{}", Services::NAME), services.encoded());
            }
            Err(error) => question.refuse(&error.to_string()),
        }
    }
}

fn own<K: Clone, V: Clone>((key, value): (&K, &V)) -> (K, V) {
    (key.clone(), value.clone())
}

fn swap(question: &Question, shared: &Shared) {
    match SwapRequest::decoded(&question.payload()) {
        Ok(request) => {
            let answer = shared.swaps.answer(request);
            let key = keys::key(&shared.vehicle, keys::SWAP);
            question.answer(&key, &format!("plumbline.v1.{}", SwapAnswer::NAME), answer.encoded());
        }
        Err(refusal) => {
            locked(&shared.refusals).count(&refusal);
            question.refuse(&refusal.to_string());
        }
    }
}

fn status(of: control::ServiceStatus) -> ServiceStatus {
    let control::ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at, troubles } =
        of;
    let (stage, at) = (stage.unwrap_or_default(), at.unwrap_or_default());
    let trouble = |control::Trouble { kind, found, remedy }| Trouble { kind, found, remedy };
    let troubles = troubles.into_iter().map(trouble).collect();
    let pid = pid.unwrap_or_default();
    ServiceStatus { service, stage, state, pid, restarts, incarnation, epoch, ticks, lost, at, troubles }
}
