//! Selection of the vehicle that a page shows: one system, a recording, or one of several vehicles.

use std::sync::Arc;

use crate::{hub::Hub, source::CommandTarget, token::Role};

/// Data source and command target of a page.
#[derive(Clone)]
pub struct VehicleView {
    /// Name of the system or the recording.
    pub system: String,
    /// Hub that publishes the snapshots.
    pub hub: Arc<Hub>,
    /// Target of commands; `None` if the page cannot send any.
    pub target: Option<Arc<dyn CommandTarget>>,
}

/// Purpose of a view. Each purpose has its own limit on open views.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ViewUse {
    /// Requests for metrics.
    Metrics,
    /// Viewers without a token.
    Anonymous,
    /// Viewers that have presented a token.
    Authorized,
}

impl ViewUse {
    /// Returns the use of a viewer with the given role; `None` stands for a viewer without a token.
    pub(crate) fn of_viewer(role: Option<Role>) -> Self {
        if role.is_some() { Self::Authorized } else { Self::Anonymous }
    }
}

/// Vehicles that a page can show.
pub trait VehicleDirectory: Send + Sync {
    /// Returns the view of the named vehicle, or the default view, for the given use.
    ///
    /// # Errors
    ///
    /// Returns a reason that can be shown to the user if the vehicle is not available.
    fn view(&self, vehicle: Option<&str>, view_use: ViewUse) -> Result<VehicleView, String>;
}

/// Directory with a single system or recording, which cannot be selected by name.
impl VehicleDirectory for VehicleView {
    fn view(&self, vehicle: Option<&str>, _: ViewUse) -> Result<VehicleView, String> {
        match vehicle {
            None => Ok(self.clone()),
            Some(vehicle) => Err(format!(
                "vehicle {vehicle:?} is not available: this page shows one system; use `plumb view --remote`"
            )),
        }
    }
}
