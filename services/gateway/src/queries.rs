//! Replies to network queries: last messages, schema, status of the services, and swaps.

use std::sync::Arc;

use control::{ControlRequest, ServiceStatus};
use link::{IncomingQuery, Link, LinkError, QueryHandler};
use runtime::clock::monotonic_ns;
use wire::{
    command::ControlMessage,
    keys, schema,
    v1::{Services, SwapAnswer, SwapRequest},
};

use crate::{locked::locked, network_publisher::LastMessages, shared::Shared, worker_pool::WorkerPool};

/// Declares the queryables. They reply until the returned values are dropped.
pub(crate) fn serve(link: &Link, shared: &Arc<Shared>, last: LastMessages) -> Result<[QueryHandler; 2], LinkError> {
    // The pools are separate, so that pending swaps do not block other queries.
    let [readers, commanders] = [(); 2].map(|()| WorkerPool::new(&shared.rejected_queries));
    let reads = link.handle_queries(&keys::key(&shared.vehicle, "*"), {
        let shared = shared.clone();
        move |query| {
            let (shared, last) = (shared.clone(), last.clone());
            readers.spawn(query, move |query| answer_read(query, &shared, &last));
        }
    })?;
    let commands = link.handle_queries(&keys::key(&shared.vehicle, keys::SWAP), {
        let shared = shared.clone();
        move |query| {
            let shared = shared.clone();
            commanders.spawn(query, move |query| answer_swap(query, &shared));
        }
    })?;
    Ok([reads, commands])
}

fn answer_read(query: &IncomingQuery, shared: &Shared, last: &LastMessages) {
    let Shared { system, vehicle, .. } = shared;
    // The messages are copied first, because a reply may block on a slow client, and the publisher
    // must not be blocked meanwhile.
    let last: Vec<_> = locked(last).iter().filter(|(key, _)| query.matches_key(key)).map(cloned).collect();
    for (key, (message, bytes)) in last {
        query.reply(&key, &message, bytes);
    }
    let key = keys::key(vehicle, keys::SCHEMA);
    if query.matches_key(&key) {
        query.reply(&key, schema::DESCRIPTORS_TYPE, schema::DESCRIPTORS.to_vec());
    }
    let key = keys::key(vehicle, keys::SERVICES);
    if query.matches_key(&key) {
        match control::send_request::<Vec<ServiceStatus>>(system, &ControlRequest::Status) {
            Ok(statuses) => {
                let services = statuses.into_iter().map(Into::into).collect();
                let services = Services { t_now_ns: monotonic_ns(), services };
                query.reply(&key, &format!("plumbline.v1.{}", Services::NAME), services.to_bytes());
            }
            Err(error) => query.reject(&error.to_string()),
        }
    }
}

fn cloned<K: Clone, V: Clone>((key, value): (&K, &V)) -> (K, V) {
    (key.clone(), value.clone())
}

fn answer_swap(query: &IncomingQuery, shared: &Shared) {
    match SwapRequest::from_bytes(&query.payload()) {
        Ok(request) => {
            let answer = shared.swaps.handle(request);
            let key = keys::key(&shared.vehicle, keys::SWAP);
            query.reply(&key, &format!("plumbline.v1.{}", SwapAnswer::NAME), answer.to_bytes());
        }
        Err(error) => {
            locked(&shared.decode_errors).count(&error);
            query.reject(&error.to_string());
        }
    }
}
