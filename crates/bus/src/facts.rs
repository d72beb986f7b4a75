//! What a program that is not built with this crate must know to join the bus of a system.

use std::path::PathBuf;

use serde::Serialize;

use crate::{Domain, port, wake};

/// Where the bus is and how its topics are opened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Facts {
    /// iceoryx2's `global.prefix`.
    pub prefix: String,
    /// iceoryx2's `global.root_path`.
    pub root: PathBuf,
    /// A file on which every member holds a shared lock (`flock`) while it lives.
    pub members: PathBuf,
    /// The page of wake words, to be mapped.
    pub page: PathBuf,
    /// Bytes from the page's start to the first topic's word, and from one topic's word to the next.
    ///
    /// At a topic's place in `messages::TOPICS` stand: wakes (u32), which counts and is waited on; waiting (u32), set by who is about
    /// to wait; next_tick (u64), the tick after the newest one published.
    pub word_bytes: usize,
    /// A payload is a slice of bytes (`u8`) with this alignment, as long as the message.
    pub alignment: usize,
    /// The text of a topic's layout is in its attributes `layout.0`, `layout.1`, … in pieces of so many bytes.
    pub layout_chunk: usize,
    /// Publishers of a topic at most.
    pub publishers: usize,
    /// The same of the topics on which every service speaks.
    pub publishers_everybody: usize,
    /// Those topics.
    pub everybody: [&'static str; 3],
    /// Readers of a topic at most.
    pub subscribers: usize,
    /// Processes on a topic at most.
    pub nodes: usize,
}

impl Domain {
    /// What a program must know to join the bus.
    pub fn facts(&self) -> Facts {
        Facts {
            prefix: self.prefix(),
            root: self.root(),
            members: self.members_path(),
            page: self.page_path(),
            word_bytes: wake::WORD_BYTES,
            alignment: port::ALIGNMENT,
            layout_chunk: port::LAYOUT_CHUNK,
            publishers: port::PUBLISHERS,
            publishers_everybody: port::EVERYBODY,
            everybody: port::OF_EVERYBODY,
            subscribers: port::SUBSCRIBERS,
            nodes: port::NODES,
        }
    }
}
