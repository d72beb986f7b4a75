//! CPU load that competes with the system under test.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

/// Threads that keep the CPU busy until this value is dropped.
pub(crate) struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    pub(crate) fn start(threads: u32) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let spin = |ends: Arc<AtomicBool>| move || while !ends.load(Ordering::Relaxed) {};
        Self { threads: (0..threads).map(|_| std::thread::spawn(spin(ends.clone()))).collect(), stop: ends }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // The thread cannot panic, so joining it cannot fail.
            let _ = thread.join();
        }
    }
}
