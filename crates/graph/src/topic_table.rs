//! The topic table.

/// Passes the topic table to the macro `callback`, followed by the caller's own lines.
///
/// The usage is `topics!(callback { arguments } lines)`. The callback receives `{ arguments }`, the
/// table and `lines`.
///
/// A line is `Topic = "name": Payload, presence, buffer, publisher => [subscribers];`
/// - *presence*: `every_tick`, `flagged(FLAG)` for ticks with that flag of `messages::Flags`, or
///   `no_tick` for messages that are not derived from an IMU sample;
/// - *buffer*: `Path` or `Control` of [`Buffer`](crate::Buffer);
/// - *publisher*, *subscribers*: names of [`participant`](crate::service::participant).
///
/// The order of the lines is the order of the wake words. The gateway can subscribe to every topic,
/// and it carries those returned by [`Graph::carried`](crate::Graph) to other hosts. The lines do
/// not list the gateway for these purposes.
#[macro_export]
macro_rules! topics {
    ($($callback:ident)::+ { $($argument:tt)* } $($more:tt)*) => {
        $($callback)::+! {
            { $($argument)* }
            Sensor = "sensor": SensorReading, no_tick, Path, feeders => [ingest];
            Receiver = "receiver": ReceiverReading, no_tick, Path, feeders => [ingest];
            Imu = "imu": ImuSample, every_tick, Path, ingest => [gyro, accel];
            Mag = "mag": MagSample, flagged(FIELD), Path, ingest => [fuser];
            Gnss = "gnss": GnssFix, flagged(FIX), Path, ingest => [fuser, course];
            Reference = "reference": Reference, no_tick, Path, ingest => [supervisor];
            Reading = "reading": TakenReading, no_tick, Path, ingest => [];
            Gyro = "gyro": GyroStep, every_tick, Path, gyro => [fuser];
            Accel = "accel": AccelPoint, every_tick, Path, accel => [fuser];
            Fused = "fused": FusedState, every_tick, Path, fuser => [course];
            Attitude = "attitude": AttitudeOutput, every_tick, Path, course => [supervisor];
            Credit = "credit": Credit, no_tick, Control, supervisor => [ingest, gateway];
            Checkpoint = "checkpoint": Checkpoint, no_tick, Control, services => [supervisor];
            Difference = "difference": Difference, no_tick, Control, candidates => [supervisor];
            Control = "control": Control, no_tick, Control, supervisor => [slots];
            Health = "health": Health, no_tick, Control, services => [supervisor, gateway, ingest];
            Event = "event": SystemEvent, no_tick, Control, supervisor => [];
            $($more)*
        }
    };
}
