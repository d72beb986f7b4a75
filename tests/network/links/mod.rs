//! Links: endpoints, queries and rejections.

mod queries;
mod tls;
