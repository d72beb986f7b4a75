//! The table.

/// Hands the table to the macro `callback`, after what is in the first braces and before lines of the caller's own:
/// `topics!(callback { arguments } lines)`.
///
/// A line is `Topic = "name": Payload, presence, buffer, publisher => [readers];`
/// - *presence*: `every_tick`, `flagged(FLAG)` where only ticks with that flag of `messages::Flags` have one, or `no_tick` where a message
///   does not descend from an IMU sample;
/// - *buffer*: `Path` or `Control`, of [`Buffer`](crate::Buffer);
/// - *publisher*, *readers*: of [`Participant::named`](crate::service::participant).
///
/// The order is that of the wake words. The gateway can read each topic, and carries to other hosts what [`Graph::carried`](crate::Graph)
/// says; the lines do not name it for that.
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
