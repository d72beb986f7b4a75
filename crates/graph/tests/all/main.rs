//! The graph as it is, and as it is with one line more.
mod added;
mod edges;
