//! What programs say of themselves, kept for as long as this process: names and parameters of stages are `'static`.
//!
//! What is the same is kept once, and no more than [`KEPT_MAX`] texts and tables are.

use std::sync::{Mutex, PoisonError};

use attitude::parameters::Parameter;
use sdk::Description;

/// More than any launch file names.
const KEPT_MAX: usize = 4096;

static TEXTS: Mutex<Vec<&'static str>> = Mutex::new(Vec::new());
static TABLES: Mutex<Vec<&'static [Parameter]>> = Mutex::new(Vec::new());

/// The text, kept; `None` when too much is.
pub(crate) fn text(text: &str) -> Option<&'static str> {
    let mut kept = TEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    let found = kept.iter().find(|kept| **kept == text).copied();
    found.or_else(|| {
        (kept.len() < KEPT_MAX).then(|| {
            let text: &'static str = Box::leak(text.into());
            kept.push(text);
            text
        })
    })
}

/// The parameters, kept; `None` when too much is.
pub(crate) fn parameters(description: &Description) -> Option<&'static [Parameter]> {
    let table = description.parameters.iter().map(|told| {
        let (name, unit, about) = (text(&told.name)?, text(&told.unit)?, text(&told.about)?);
        Some(Parameter { name, unit, default: told.default, least: told.least, most: told.most, about })
    });
    let table = table.collect::<Option<Vec<_>>>()?;
    let mut kept = TABLES.lock().unwrap_or_else(PoisonError::into_inner);
    let found = kept.iter().find(|kept| **kept == table).copied();
    found.or_else(|| {
        (kept.len() < KEPT_MAX).then(|| {
            let table: &'static [Parameter] = Box::leak(table.into());
            kept.push(table);
            table
        })
    })
}
