//! Names and parameters of external stages, interned because stages require `'static` data.
//!
//! Equal entries are stored once. The number of texts and the number of tables are each limited to
//! [`MAX_INTERNED`].

use std::sync::{Mutex, PoisonError};

use attitude::parameters::Parameter;
use foreign::ForeignText;
use sdk::Description;

/// Maximum number of entries, which is more than any launch file needs.
const MAX_INTERNED: usize = 4096;

static TEXTS: Mutex<Vec<&'static str>> = Mutex::new(Vec::new());
static TABLES: Mutex<Vec<&'static [Parameter]>> = Mutex::new(Vec::new());

/// Interns a text. Returns `None` if the limit is reached.
pub(crate) fn text(text: &str) -> Option<&'static str> {
    let mut interned = TEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    let found = interned.iter().find(|interned| **interned == text).copied();
    found.or_else(|| {
        (interned.len() < MAX_INTERNED).then(|| {
            let text: &'static str = Box::leak(text.into());
            interned.push(text);
            text
        })
    })
}

/// Interns the parameters of a description, with their texts escaped. Returns `None` if the limit
/// is reached.
pub(crate) fn parameters(description: &Description) -> Option<&'static [Parameter]> {
    let escaped = |written: &str| text(&ForeignText::from(written).to_string());
    let table = description.parameters.iter().map(|parameter| {
        let (name, unit, about) =
            (escaped(&parameter.name)?, escaped(&parameter.unit)?, escaped(&parameter.description)?);
        Some(Parameter {
            name,
            unit,
            default: parameter.default,
            min: parameter.min,
            max: parameter.max,
            description: about,
        })
    });
    let table = table.collect::<Option<Vec<_>>>()?;
    let mut interned = TABLES.lock().unwrap_or_else(PoisonError::into_inner);
    let found = interned.iter().find(|interned| **interned == table).copied();
    found.or_else(|| {
        (interned.len() < MAX_INTERNED).then(|| {
            let table: &'static [Parameter] = Box::leak(table.into());
            interned.push(table);
            table
        })
    })
}
