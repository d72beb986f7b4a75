//! Scores of the program, compared with those of the stages without the program.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod bare_chain;
