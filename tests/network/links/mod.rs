//! What a link promises its callers: endpoints, questions and answers, refusals.

mod asking;
mod secured;
