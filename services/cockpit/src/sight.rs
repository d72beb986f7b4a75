//! What a page can look at: one system, a recording, or any of several vehicles.

use std::sync::Arc;

use crate::{hub::Hub, source::CommandTarget};

/// Where a page's pictures come from.
#[derive(Clone)]
pub struct Look {
    /// The system's name, or that of the recording.
    pub system: String,
    /// Between who makes pictures and this page.
    pub hub: Arc<Hub>,
    /// Who takes commands.
    pub desk: Option<Arc<dyn CommandTarget>>,
}

/// What can be looked at.
pub trait Sight: Send + Sync {
    /// The vehicle of that name, or what is shown where none is named; why not, for people.
    fn look(&self, vehicle: Option<&str>) -> Result<Look, String>;
}

/// One system, or a recording.
impl Sight for Look {
    fn look(&self, vehicle: Option<&str>) -> Result<Look, String> {
        match vehicle {
            None => Ok(self.clone()),
            Some(vehicle) => {
                Err(format!("{vehicle:?} cannot be chosen here: `plumb view --remote` shows vehicles elsewhere"))
            }
        }
    }
}
