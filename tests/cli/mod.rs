//! The command line as people use it.

mod calibrate;
mod help;
mod keys;
mod means;
mod output;
mod seeing;
mod terminal;
mod up;
mod warnings;
