//! Threads that reply to queries. A reply may block on its client, and Zenoh's own threads must not
//! block.
//!
//! Each query has its own thread, up to a limit. One more thread rejects the queries beyond this
//! limit. If that thread's backlog is full, queries are dropped, which ends them without a reply.
//! Rejected and dropped queries are counted.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
        mpsc::{SyncSender, sync_channel},
    },
    thread,
};

use link::IncomingQuery;

/// Maximum number of concurrent queries.
const MAX_WORKERS: usize = 8;
/// Maximum number of queries waiting to be rejected.
const MAX_PENDING_REJECTIONS: usize = 64;

/// Pool with a limited number of threads for one kind of query.
#[derive(Debug, Clone)]
pub(crate) struct WorkerPool {
    busy: Arc<AtomicUsize>,
    rejections: SyncSender<IncomingQuery>,
    rejected_queries: Arc<AtomicU64>,
}

impl WorkerPool {
    /// Creates a pool that counts rejected queries in a shared counter.
    pub(crate) fn new(rejected_queries: &Arc<AtomicU64>) -> Self {
        let (rejections, queries) = sync_channel::<IncomingQuery>(MAX_PENDING_REJECTIONS);
        thread::spawn(move || {
            queries.iter().for_each(|query| query.reject("too many concurrent queries; try again"));
        });
        Self { busy: Arc::default(), rejections, rejected_queries: rejected_queries.clone() }
    }

    /// Runs `answer` for the query in a new thread, or rejects the query if the pool is busy.
    pub(crate) fn spawn(&self, query: IncomingQuery, answer: impl FnOnce(&IncomingQuery) + Send + 'static) {
        if self.busy.fetch_add(1, Ordering::SeqCst) >= MAX_WORKERS {
            self.busy.fetch_sub(1, Ordering::SeqCst);
            self.rejected_queries.fetch_add(1, Ordering::Relaxed);
            // If the backlog is full, the query is dropped, which ends it.
            let _ = self.rejections.try_send(query);
            return;
        }
        let busy = self.busy.clone();
        thread::spawn(move || {
            answer(&query);
            busy.fetch_sub(1, Ordering::SeqCst);
        });
    }
}

#[cfg(test)]
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
    fn excess_queries_are_rejected_and_counted() {
        let rejected_queries = Arc::default();
        let workers = WorkerPool::new(&rejected_queries);
        let endpoint = format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap());
        let board = Link::open(&Endpoints { listen: vec![endpoint.clone()], ..Endpoints::default() }).unwrap();
        // Each reply blocks, like a reply to a client that does not read.
        let (release, released) = mpsc::channel::<()>();
        let (released, busy) = (Arc::new(Mutex::new(released)), workers.busy.clone());
        let answer_query = move |query| {
            let released = released.clone();
            workers.spawn(query, move |query| {
                let _ = released.lock().map(|released| released.recv());
                query.reply_raw(KEY, vec![1]);
            });
        };
        let _answering = board.handle_queries(KEY, answer_query).unwrap();
        let link = Link::open(&Endpoints::with_connect(&[endpoint])).unwrap();
        assert!(link.wait_for_peer(LIMIT));
        thread::scope(|scope| {
            let asking: Vec<_> =
                (0..MAX_WORKERS).map(|_| scope.spawn(|| link.query(KEY, Vec::new(), LIMIT).unwrap())).collect();
            let deadline = Instant::now() + LIMIT;
            while busy.load(Ordering::SeqCst) < MAX_WORKERS && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(5));
            }
            let error = link.query(KEY, Vec::new(), LIMIT).unwrap_err();
            drop(release);
            assert!(
                matches!(&error, LinkError::Rejected { reason, .. } if reason.raw().contains("too many")),
                "{error}"
            );
            for asking in asking {
                assert_eq!(asking.join().unwrap().len(), 1);
            }
        });
        assert_eq!(rejected_queries.load(Ordering::Relaxed), 1);
    }
}
