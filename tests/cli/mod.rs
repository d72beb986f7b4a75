//! Command-line interface: arguments, output, messages and exit codes.

mod calibrate;
mod demo;
mod detached;
mod doctor;
mod help;
mod hostile;
mod keys;
mod manual;
mod observers;
mod output;
mod resources;
mod settings;
mod terminal;
mod up;
mod warnings;
