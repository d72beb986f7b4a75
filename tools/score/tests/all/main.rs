//! Compares the scores of the program with those of the bare stages.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod bare_chain;
