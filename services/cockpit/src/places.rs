//! Limits on the number of clients. Each client occupies a place, and each class of clients has a
//! limited number of places.
//!
//! Input: the address of each client, the use of its connection and the role that its token grants.
//! Output: a place, or an error if the places of its class are taken.
//! Failure: a class of clients without a token admits every newcomer. If all its places are taken,
//! a newcomer displaces the oldest client of the address that occupies the most places. A newcomer
//! therefore always has time to present a token.

use std::{
    collections::BTreeMap,
    net::{IpAddr, Ipv6Addr},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
};

use tokio::sync::Semaphore;

use crate::{inflow::Inflow, locked::lock, token::Role};

/// Maximum number of requests on a connection without a token. A browser needs about this many
/// per connection to load the page.
const MAX_REQUESTS_WITHOUT_TOKEN: u32 = 8;

/// Use of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Use {
    /// HTTP requests.
    Requests,
    /// WebSocket of a viewer.
    Viewer,
    /// WebSocket of a Foxglove client.
    #[cfg(feature = "foxglove")]
    Foxglove,
}

/// Clients that share a limited number of places.
type Class = (Use, Option<Role>);

/// Limits of a class.
struct Limits {
    /// Maximum number of places.
    total: usize,
    /// Maximum number of places per address.
    per_address: usize,
    /// `true` if a newcomer beyond the limits displaces another client, `false` if the newcomer is
    /// rejected.
    displaces: bool,
}

/// Returns the limits of a class.
fn limits((usage, role): Class) -> Limits {
    let (total, per_address) = match (usage, role) {
        (Use::Requests, None | Some(Role::Viewer)) => (64, 32),
        (Use::Requests, Some(Role::Operator)) => (32, 32),
        (Use::Viewer, None | Some(Role::Viewer)) => (32, 16),
        (Use::Viewer, Some(Role::Operator)) => (16, 16),
        #[cfg(feature = "foxglove")]
        (Use::Foxglove, _) => (8, 8),
    };
    // A newcomer displaces another client so that it can present a token. A Foxglove client cannot
    // present one after the connection is established, so it displaces no other client.
    let displaces = role.is_none() && matches!(usage, Use::Requests | Use::Viewer);
    Limits { total, per_address, displaces }
}

/// Error if the places of a class are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("too many clients; close another page or client")]
pub(crate) struct NoPlace;

/// Places of all clients.
#[derive(Debug, Default)]
pub(crate) struct Places(Mutex<Occupants>);

#[derive(Debug, Default)]
struct Occupants {
    /// Occupants by entry number, so that the oldest comes first. An occupant gets an entry number
    /// when it enters a class.
    by_entry: BTreeMap<u64, Occupant>,
    next_entry: u64,
}

#[derive(Debug, Clone)]
struct Occupant {
    network: IpAddr,
    class: Class,
    /// Closed when the occupant is displaced.
    displaced: Arc<Semaphore>,
}

/// Place of a client. It is free again when the last clone is dropped.
#[derive(Clone)]
pub(crate) struct Place(Arc<PlaceState>);

struct PlaceState {
    places: Arc<Places>,
    /// Entry number of the occupant.
    entry: Mutex<u64>,
    displaced: Arc<Semaphore>,
    requests: AtomicU32,
    inflow: Arc<Inflow>,
}

impl Places {
    /// Returns the place of a new connection, which has not presented a token yet.
    pub(crate) fn admit(self: &Arc<Self>, address: IpAddr) -> Place {
        let displaced = Arc::new(Semaphore::new(0));
        let class = (Use::Requests, None);
        let occupant = Occupant { network: network(address), class, displaced: displaced.clone() };
        let mut occupants = lock(&self.0);
        // A class of clients without a token always has room.
        let _ = occupants.make_room(occupant.network, class);
        let entry = Mutex::new(occupants.insert(occupant));
        drop(occupants);
        let (places, requests) = (self.clone(), AtomicU32::new(0));
        Place(Arc::new(PlaceState { places, entry, displaced, requests, inflow: Arc::default() }))
    }
}

impl Occupants {
    fn insert(&mut self, occupant: Occupant) -> u64 {
        let entry = self.next_entry;
        self.next_entry += 1;
        self.by_entry.insert(entry, occupant);
        entry
    }

    /// Makes room for a newcomer to the class, if necessary by displacing an occupant.
    fn make_room(&mut self, newcomer: IpAddr, class: Class) -> Result<(), NoPlace> {
        let limits = limits(class);
        let mut counts = BTreeMap::<IpAddr, usize>::new();
        let in_class = || self.by_entry.iter().filter(|(_, occupant)| occupant.class == class);
        in_class().for_each(|(_, occupant)| *counts.entry(occupant.network).or_default() += 1);
        let crowded = if counts.get(&newcomer).is_some_and(|count| *count >= limits.per_address) {
            newcomer
        } else if counts.values().sum::<usize>() >= limits.total {
            counts.iter().max_by_key(|(_, count)| **count).map_or(newcomer, |(network, _)| *network)
        } else {
            return Ok(());
        };
        if !limits.displaces {
            return Err(NoPlace);
        }
        let oldest = in_class().find(|(_, occupant)| occupant.network == crowded).map(|(entry, _)| *entry);
        if let Some(occupant) = oldest.and_then(|entry| self.by_entry.remove(&entry)) {
            occupant.displaced.close();
        }
        Ok(())
    }
}

impl Place {
    /// Returns the role that the client's token grants; `None` if it has not presented one.
    pub(crate) fn role(&self) -> Option<Role> {
        let occupants = lock(&self.0.places.0);
        occupants.by_entry.get(&self.entry()).and_then(|occupant| occupant.class.1)
    }

    /// Moves the client to the class of its new use.
    ///
    /// # Errors
    ///
    /// Fails if all places of the class are taken. The client then keeps its previous place.
    pub(crate) fn change_use(&self, usage: Use) -> Result<(), NoPlace> {
        self.change_class(|(_, role)| (usage, role))
    }

    /// Moves the client to the class of clients that have presented a token. The role of an
    /// operator is kept.
    ///
    /// # Errors
    ///
    /// Fails if all places of the class are taken. The client then keeps its previous place.
    pub(crate) fn show_token(&self, role: Role) -> Result<(), NoPlace> {
        self.change_class(|(usage, known)| (usage, known.filter(|known| *known == Role::Operator).or(Some(role))))
    }

    fn change_class(&self, change: impl FnOnce(Class) -> Class) -> Result<(), NoPlace> {
        let mut occupants = lock(&self.0.places.0);
        let mut entry = lock(&self.0.entry);
        // A displaced client has no place to move from.
        let occupant = occupants.by_entry.get(&entry).cloned().ok_or(NoPlace)?;
        let class = change(occupant.class);
        if class == occupant.class {
            return Ok(());
        }
        occupants.make_room(occupant.network, class)?;
        occupants.by_entry.remove(&entry);
        *entry = occupants.insert(Occupant { class, ..occupant });
        Ok(())
    }

    /// Counts a request. Returns `false` if the connection must be closed after the response.
    pub(crate) fn count_request(&self) -> bool {
        let requests = self.0.requests.fetch_add(1, Ordering::Relaxed).saturating_add(1);
        requests < MAX_REQUESTS_WITHOUT_TOKEN || self.role().is_some()
    }

    /// Returns the count of the bytes received from the client.
    pub(crate) fn inflow(&self) -> &Arc<Inflow> {
        &self.0.inflow
    }

    /// Runs a future until it completes or the client is displaced.
    pub(crate) async fn hold(&self, future: impl Future<Output = ()>) {
        tokio::select! {
            biased;
            // The semaphore has no permits, so this completes only when it is closed.
            _ = self.0.displaced.acquire() => {}
            () = future => {}
        }
    }

    fn entry(&self) -> u64 {
        *lock(&self.0.entry)
    }
}

impl Drop for PlaceState {
    fn drop(&mut self) {
        let entry = *self.entry.get_mut().unwrap_or_else(PoisonError::into_inner);
        lock(&self.places.0).by_entry.remove(&entry);
    }
}

/// Returns the part of an address that a user cannot vary at will. This is the whole IPv4 address,
/// or the first 64 bits of an IPv6 address.
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX)).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        [192, 0, 2, last].into()
    }

    fn is_displaced(place: &Place) -> bool {
        place.0.displaced.is_closed()
    }

    fn admit(places: &Arc<Places>, from: u8, count: usize) -> Vec<Place> {
        (0..count).map(|_| places.admit(address(from))).collect()
    }

    #[test]
    fn address_with_most_places_gives_way_to_newcomer() {
        let places = Arc::default();
        let honest = admit(&places, 1, 1);
        let crowds: Vec<_> = [2, 3, 4].into_iter().flat_map(|from| admit(&places, from, 100)).collect();
        assert!(!is_displaced(&honest[0]), "the only place of an address is kept");
        let kept = crowds.iter().filter(|place| !is_displaced(place)).count();
        assert_eq!(kept + 1, limits((Use::Requests, None)).total);
        assert!(!is_displaced(crowds.last().unwrap()), "the newest is admitted");
        let one_address = limits((Use::Requests, None)).per_address;
        let kept = |from: usize| crowds[from * 100..][..100].iter().filter(|place| !is_displaced(place)).count();
        assert!((0..3).all(|from| kept(from) <= one_address));
    }

    #[test]
    fn clients_with_token_are_never_displaced() {
        let places = Arc::default();
        let operator = admit(&places, 1, 1).remove(0);
        operator.change_use(Use::Viewer).unwrap();
        operator.show_token(Role::Operator).unwrap();
        let crowd = admit(&places, 1, 200);
        for place in crowd.iter().filter(|place| !is_displaced(place)) {
            place.change_use(Use::Viewer).unwrap();
        }
        assert!(!is_displaced(&operator));
        operator.show_token(Role::Viewer).unwrap();
        assert_eq!(operator.role(), Some(Role::Operator));
        assert_eq!(crowd[0].show_token(Role::Operator), Err(NoPlace), "a displaced client stays displaced");
    }

    #[test]
    fn viewers_token_cannot_take_places_of_operators() {
        let places = Arc::default();
        let enter = |from: u8, role| {
            let place = admit(&places, from, 1).remove(0);
            place.show_token(role)?;
            place.change_use(Use::Viewer).map(|()| place)
        };
        let viewers: Vec<_> = (0..100).filter_map(|n| enter(n % 4, Role::Viewer).ok()).collect();
        assert_eq!(viewers.len(), limits((Use::Viewer, Some(Role::Viewer))).total);
        assert!(viewers.iter().all(|place| !is_displaced(place)), "no client gives way");
        let operator = enter(1, Role::Operator).unwrap();
        drop(viewers);
        assert!(enter(1, Role::Viewer).is_ok(), "a place is free again after its client has gone");
        drop(operator);
        assert!(lock(&places.0).by_entry.is_empty());
    }

    #[test]
    fn only_connection_with_token_has_unlimited_requests() {
        let places = Arc::default();
        let place = admit(&places, 1, 1).remove(0);
        let served = (1..100).take_while(|_| place.count_request()).count();
        assert_eq!(served + 1, MAX_REQUESTS_WITHOUT_TOKEN as usize);
        place.show_token(Role::Viewer).unwrap();
        assert!((0..1000).all(|_| place.count_request()));
    }

    #[test]
    fn addresses_of_one_ipv6_network_count_together() {
        let same = |a: &str, b: &str| network(a.parse().unwrap()) == network(b.parse().unwrap());
        assert!(same("2001:db8::1", "2001:db8::ffff:1") && same("::ffff:192.0.2.1", "192.0.2.1"));
        assert!(!same("2001:db8::1", "2001:db8:0:1::1") && !same("192.0.2.1", "192.0.2.2"));
    }
}
