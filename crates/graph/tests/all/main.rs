//! Tests of the system's graph and of a graph with additional topics.
mod added;
mod edges;
