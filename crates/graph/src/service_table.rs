//! The service table.

/// Passes the service table to the macro `callback`.
///
/// The usage is `services!(callback { arguments })`. The callback receives `{ arguments }` and the
/// table.
///
/// A line is `Service = name: properties;`
/// - *name*: the variant in lower case, name in launch files and messages and of the crate in
///   `services/`;
/// - *properties*: `Listed` if a launch file may list the service, `CarriesTicks` if it carries
///   ticks between the hosts of a split system, `LowPriority` if nothing on board waits for it.
///
/// The order of the lines is the order of [`Service::ALL`](crate::Service::ALL), and thus of the
/// index in messages. A new service therefore comes last.
#[macro_export]
macro_rules! services {
    ($($callback:ident)::+ { $($argument:tt)* }) => {
        $($callback)::+! {
            { $($argument)* }
            source {
                /// Checks, calibrates and numbers the readings of the source.
                Ingest = ingest: Listed;
            }
            slots {
                /// Integrates the angular rate.
                Gyro = gyro: Listed;
                /// Estimates the vertical from the specific force.
                Accel = accel: Listed;
                /// Fuses gyro and accelerometer into an attitude.
                Fuser = fuser: Listed;
                /// Computes angles and course from the attitude.
                Course = course: Listed;
            }
            auxiliary {
                /// Exchanges messages with other hosts.
                Gateway = gateway: Listed CarriesTicks LowPriority;
                /// Reads the devices of a live source.
                Drivers = drivers: ;
                /// Serves the web page.
                Cockpit = cockpit: Listed LowPriority;
            }
        }
    };
}
