//! What the table says of the payloads: which topic carries which, which of them begin with a header, and the way from a topic to a type.

/// Ties payloads to their lines of the table `$table`. Those of topics with ticks begin with a field `header`.
macro_rules! carry {
    ({ $table:path } $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($reader:ident),*];)*
    ) => {
        $($crate::binding::carry_one! { <$table>::$topic.entry(), $payload, $presence $(($flag))? })*
    };
}

/// Ties one payload to its line.
macro_rules! carry_one {
    ($entry:expr, $payload:ident, no_tick) => {
        impl $crate::Message for $payload {
            const TOPIC: &'static graph::Entry = $entry;
            const TYPE: &'static str = Self::TYPE_NAME;

            fn layout() -> $crate::Layout {
                Self::own_layout().on($entry.name)
            }

            fn source_time_ns(&self, rate_hz: f64) -> Option<i64> {
                Self::OWN_TIME_NS(self, rate_hz)
            }
        }
    };
    ($entry:expr, $payload:ident, every_tick) => {
        $crate::binding::carry_one! { $entry, $payload, flagged(NONE) }
    };
    ($entry:expr, $payload:ident, flagged($flag:ident)) => {
        impl $crate::Message for $payload {
            const TOPIC: &'static graph::Entry = $entry;
            const TYPE: &'static str = Self::TYPE_NAME;

            fn layout() -> $crate::Layout {
                Self::own_layout().on($entry.name).with_header($crate::Header::layout())
            }

            fn source_time_ns(&self, rate_hz: f64) -> Option<i64> {
                Self::OWN_TIME_NS(self, rate_hz).or(Some(self.header.t_end_ns))
            }
        }

        impl $crate::Ticked for $payload {
            const FLAG: $crate::Flags = $crate::Flags::$flag;

            fn header(&self) -> &$crate::Header {
                &self.header
            }

            fn header_mut(&mut self) -> &mut $crate::Header {
                &mut self.header
            }
        }
    };
}

/// The value of an expression in which `M` is the type of a topic's payload: `dispatch!(topic, M => expression)`.
///
/// Where it needs to know whether messages of the topic have a tick, it has an expression for each:
/// `dispatch!(topic, ticked M => expression, other M => expression)`; in the first `M` is [`Ticked`](crate::Ticked).
#[macro_export]
macro_rules! dispatch {
    ($topic:expr, $M:ident => $body:expr) => {
        $crate::dispatch!($topic, ticked $M => $body, other $M => $body)
    };
    ($topic:expr, ticked $T:ident => $ticked:expr, other $M:ident => $other:expr) => {
        $crate::graph::topics!($crate::dispatch_arms { $crate ($topic) $T ($ticked) $M ($other) })
    };
}

/// A match with an arm for each line of the table; `$in` has both the topics and the payloads.
#[doc(hidden)]
#[macro_export]
macro_rules! dispatch_arms {
    ({ $in:tt ($value:expr) $T:ident ($ticked:expr) $M:ident ($other:expr) }
        $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($reader:ident),*];)*
    ) => {
        match $value {
            $($in::graph::Topic::$topic => $crate::dispatch_arm!($presence $in $payload $T ($ticked) $M ($other)),)*
        }
    };
}

/// What an arm does.
#[doc(hidden)]
#[macro_export]
macro_rules! dispatch_arm {
    (no_tick $in:tt $payload:ident $T:ident ($ticked:expr) $M:ident ($other:expr)) => {{
        #[allow(dead_code, reason = "an expression may do without it")]
        type $M = $in::$payload;
        $other
    }};
    ($presence:ident $in:tt $payload:ident $T:ident ($ticked:expr) $M:ident ($other:expr)) => {{
        #[allow(dead_code, reason = "an expression may do without it")]
        type $T = $in::$payload;
        $ticked
    }};
}

pub(crate) use {carry, carry_one};

#[cfg(test)]
mod tests {
    //! A topic more is a line more and its payload: what is made of the table is made for it.
    use crate::{Flags, Message, Ticked};

    /// The lines that are added.
    macro_rules! lines {
        ($($callback:ident)::+ { $($argument:tt)* }) => {
            $($callback)::+! { { $($argument)* }
                Pressure = "pressure": PressureSample, flagged(GAP), Path, ingest => [fuser];
                Brake = "brake": BrakeState, no_tick, Control, feeders => [ingest];
            }
        };
    }

    /// The system's table with them.
    macro_rules! longer {
        ({ $($callback:ident)::+ { $($argument:tt)* } } $($line:tt)*) => {
            graph::topics! { $($callback)::+ { $($argument)* } $($line)* }
        };
    }

    #[expect(unreachable_pub, reason = "payloads are public")]
    mod more {
        pub(super) mod graph {
            use ::graph;
            lines!(longer { graph::define_topics {} });
        }

        pub(super) use crate::*;

        crate::layout::payload! {
            /// The pressure of the air.
            PressureSample = "plumbline.PressureSample.1" {
                /// Tick, interval, flags.
                header: Header,
                /// Static pressure, Pa.
                pressure_pa: f64,
            }
        }

        crate::layout::payload! {
            /// What the brakes do.
            BrakeState = "plumbline.BrakeState.1" at (|state, _| Some(state.t_ns)) {
                /// When, ns.
                t_ns: i64,
            }
        }
    }

    use more::{BrakeState, PressureSample, graph::Topic};

    lines!(crate::binding::carry { Topic });

    fn described(topic: Topic) -> (&'static str, usize, Option<Flags>) {
        lines!(longer { crate::dispatch_arms { more (topic) T ((T::TYPE, size_of::<T>(), Some(T::FLAG))) M ((M::TYPE, size_of::<M>(), None)) } })
    }

    #[test]
    fn its_payload_has_the_traits_that_its_line_says() {
        assert_eq!((PressureSample::TOPIC.name, PressureSample::FLAG), ("pressure", Flags::GAP));
        assert_eq!(BrakeState::TOPIC.place, crate::graph::Topic::ALL.len() + 1);
        let mut sample: PressureSample = bytemuck::Zeroable::zeroed();
        sample.header_mut().t_end_ns = 5;
        assert_eq!((sample.source_time_ns(1000.0), BrakeState { t_ns: 7 }.source_time_ns(1000.0)), (Some(5), Some(7)));
    }

    #[test]
    fn its_layout_has_its_topic_and_the_fields_of_the_header() {
        let layout = PressureSample::layout();
        assert_eq!((layout.topic, layout.size, layout.header_fields), (Some("pressure"), 72, 9));
        assert_eq!(layout.fields.last().map(|field| (field.name, field.offset)), Some(("pressure_pa", 64)));
    }

    #[test]
    fn dispatch_hands_out_its_type() {
        assert_eq!(described(Topic::Pressure), ("plumbline.PressureSample.1", 72, Some(Flags::GAP)));
        assert_eq!(described(Topic::Brake), ("plumbline.BrakeState.1", 8, None));
        assert_eq!(described(Topic::Imu), ("plumbline.ImuSample.1", 112, Some(Flags::NONE)));
    }
}
