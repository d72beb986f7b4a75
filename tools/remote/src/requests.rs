//! Requests to a remote vehicle.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use control::{ServiceStatus, SwapReport};
use launch::StageConfig;
use link::{Link, LinkError};
use wire::{
    command::ControlMessage,
    keys,
    v1::{Services, SwapAnswer, SwapRequest},
};

use crate::{endpoint::RemoteEndpoint, error::RemoteError};

/// Timeout for the reply to a request that is answered immediately.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Time from a swap request to its deadline.
const SWAP_TIMEOUT: Duration = Duration::from_secs(30);

/// Returns the status of a vehicle's services.
///
/// # Errors
///
/// Fails if the vehicle does not reply.
pub fn services(link: &Link, vehicle: &str) -> Result<Vec<ServiceStatus>, RemoteError> {
    Ok(query_services(link, vehicle)?.services.into_iter().map(Into::into).collect())
}

/// Swaps the stage of a slot of a vehicle over `link`, which was opened at `endpoint`.
///
/// # Errors
///
/// Fails if the vehicle does not reply or accepts no commands from this client.
pub fn swap(
    link: &Link,
    endpoint: &RemoteEndpoint,
    vehicle: &str,
    slot: &str,
    stage: StageConfig,
) -> Result<SwapReport, RemoteError> {
    let Services { t_now_ns, services } = query_services(link, vehicle)?;
    let status = services.into_iter().find(|one| one.service == slot);
    // If the slot is unknown, the epoch does not matter, because the vehicle rejects the request
    // anyway.
    let expected_epoch = status.map_or(1, |one| one.epoch).max(1);
    let request = SwapRequest {
        request_id: request_id(),
        slot: slot.into(),
        stage: stage.stage,
        set: stage.set,
        expected_epoch,
        t_deadline_ns: t_now_ns + SWAP_TIMEOUT.as_nanos() as u64,
    };
    let started = Instant::now();
    let reply: Result<SwapAnswer, _> =
        link.query_one(&keys::key(vehicle, keys::SWAP), request.to_bytes(), SWAP_TIMEOUT + RESPONSE_TIMEOUT);
    match reply {
        Ok(answer) => Ok(answer.into()),
        // The vehicle has just responded, so an immediate failure means that an access list denied
        // the query.
        Err(LinkError::NoResponse { .. }) if started.elapsed() < SWAP_TIMEOUT => {
            let (vehicle, SwapRequest { slot, stage, .. }) = (vehicle.into(), request);
            Err(match endpoint.plain() {
                Some(endpoint) => RemoteError::PlainReadOnly { vehicle, endpoint: endpoint.into(), slot, stage },
                None => RemoteError::ReadOnly { vehicle },
            })
        }
        Err(error) => Err(error.into()),
    }
}

fn query_services(link: &Link, vehicle: &str) -> Result<Services, LinkError> {
    link.query_one(&keys::key(vehicle, keys::SERVICES), Vec::new(), RESPONSE_TIMEOUT)
}

/// Returns a unique request id, composed of the process id and the time.
fn request_id() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("{}-{:x}", std::process::id(), since.as_nanos())
}
