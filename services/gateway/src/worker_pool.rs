//! Who sees to questions, away from the network's own threads: an answer waits for its reader, and the network must not.
//!
//! Up to a limit each question has a thread of its own. Those beyond are told so by one more thread, and those beyond what it has before
//! it end without an answer; both are counted.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
        mpsc::{SyncSender, sync_channel},
    },
    thread,
};

use link::Question;

/// Questions at once.
const CLERKS_MAX: usize = 8;
/// Questions that wait to be turned away.
const TURNED_AWAY_MAX: usize = 64;

/// Those who see to the questions of a kind.
#[derive(Debug, Clone)]
pub(crate) struct WorkerPool {
    busy: Arc<AtomicUsize>,
    refusing: SyncSender<Question>,
    turned_away: Arc<AtomicU64>,
}

impl WorkerPool {
    /// Workers that count whom they turn away.
    pub(crate) fn new(turned_away: &Arc<AtomicU64>) -> Self {
        let (refusing, questions) = sync_channel::<Question>(TURNED_AWAY_MAX);
        thread::spawn(move || {
            questions.iter().for_each(|question| question.refuse("too many questions at once; ask again"));
        });
        Self { busy: Arc::default(), refusing, turned_away: turned_away.clone() }
    }

    /// Has a question seen to.
    pub(crate) fn see_to(&self, question: Question, see_to: impl FnOnce(&Question) + Send + 'static) {
        if self.busy.fetch_add(1, Ordering::SeqCst) >= CLERKS_MAX {
            self.busy.fetch_sub(1, Ordering::SeqCst);
            self.turned_away.fetch_add(1, Ordering::Relaxed);
            // One for which there is no room is dropped, which ends it.
            let _ = self.refusing.try_send(question);
            return;
        }
        let busy = self.busy.clone();
        thread::spawn(move || {
            see_to(&question);
            busy.fetch_sub(1, Ordering::SeqCst);
        });
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use std::{
        net::TcpListener,
        sync::{Mutex, mpsc},
        time::{Duration, Instant},
    };

    use link::{Endpoints, Link, LinkError};

    use super::*;

    const KEY: &str = "workers/thing";
    const LIMIT: Duration = Duration::from_secs(60);

    #[test]
    fn the_network_waits_for_no_clerk_and_whoever_finds_none_is_told_so_and_counted() {
        let turned_away = Arc::default();
        let workers = WorkerPool::new(&turned_away);
        let endpoint = format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap());
        let board = Link::open(&Endpoints { listen: vec![endpoint.clone()], ..Endpoints::default() }).unwrap();
        // Each answer waits as one for a reader who does not read.
        let (release, waits) = mpsc::channel::<()>();
        let (waits, busy) = (Arc::new(Mutex::new(waits)), workers.busy.clone());
        let answer = move |question| {
            let waits = waits.clone();
            workers.see_to(question, move |question| {
                let _ = waits.lock().map(|waits| waits.recv());
                question.hand_over(KEY, vec![1]);
            });
        };
        let _answering = board.answering(KEY, answer).unwrap();
        let link = Link::open(&Endpoints::connecting(&[endpoint])).unwrap();
        assert!(link.await_somebody(LIMIT));
        thread::scope(|scope| {
            let asking: Vec<_> =
                (0..CLERKS_MAX).map(|_| scope.spawn(|| link.ask(KEY, Vec::new(), LIMIT).unwrap())).collect();
            let deadline = Instant::now() + LIMIT;
            while busy.load(Ordering::SeqCst) < CLERKS_MAX && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(5));
            }
            let error = link.ask(KEY, Vec::new(), LIMIT).unwrap_err();
            drop(release);
            assert!(matches!(&error, LinkError::Refused { reason, .. } if reason.contains("too many")), "{error}");
            for asking in asking {
                assert_eq!(asking.join().unwrap().len(), 1);
            }
        });
        assert_eq!(turned_away.load(Ordering::Relaxed), 1);
    }
}
