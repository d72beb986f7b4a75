//! Tests of the system's graph and of an extended one.
mod added;
mod edges;
