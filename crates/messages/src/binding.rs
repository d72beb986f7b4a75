//! Binds each payload type to its topic in the table of [`graph`] and dispatches from topic to
//! type.

use graph::Topic;

use crate::payloads::*;

/// Implements [`Message`](crate::Message) for each payload of `$table`. Payloads of topics with
/// ticks start with a `header` field and also implement [`Ticked`](crate::Ticked).
macro_rules! bind_payloads {
    ({ $table:path } $($topic:ident = $name:literal: $payload:ident, $presence:ident $(($flag:ident))?, $buffer:ident,
        $publisher:ident => [$($reader:ident),*];)*
    ) => {
        $(bind_payload! { <$table>::$topic.entry(), $payload, $presence $(($flag))? })*
    };
}

/// Implements [`Message`](crate::Message) for one payload and, if its topic has ticks, also
/// [`Ticked`](crate::Ticked).
macro_rules! bind_payload {
    ($entry:expr, $payload:ident, no_tick) => {
        impl $crate::Message for $payload {
            const TOPIC: &'static graph::Entry = $entry;
            const TYPE: &'static str = Self::TYPE_NAME;

            fn layout() -> $crate::Layout {
                Self::struct_layout().with_topic($entry.name)
            }

            fn source_time_ns(&self) -> Option<i64> {
                Self::SOURCE_TIME_NS(self)
            }
        }
    };
    ($entry:expr, $payload:ident, every_tick) => {
        bind_payload! { $entry, $payload, flagged(NONE) }
    };
    ($entry:expr, $payload:ident, flagged($flag:ident)) => {
        impl $crate::Message for $payload {
            const TOPIC: &'static graph::Entry = $entry;
            const TYPE: &'static str = Self::TYPE_NAME;

            fn layout() -> $crate::Layout {
                Self::struct_layout().with_topic($entry.name).with_header($crate::Header::layout())
            }

            fn source_time_ns(&self) -> Option<i64> {
                Self::SOURCE_TIME_NS(self).or(Some(self.header.t_end_ns))
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

/// Evaluates an expression in which `M` is the payload type of a topic.
///
/// The usage is `dispatch!(topic, M => expression)`. If the expression depends on whether messages
/// of the topic have a tick, the usage is `dispatch!(topic, ticked M => expression, other M =>
/// expression)`. In the first expression `M` implements [`Ticked`](crate::Ticked).
#[macro_export]
macro_rules! dispatch {
    ($topic:expr, $M:ident => $body:expr) => {
        $crate::dispatch!($topic, ticked $M => $body, other $M => $body)
    };
    ($topic:expr, ticked $T:ident => $ticked:expr, other $M:ident => $other:expr) => {
        $crate::graph::topics!($crate::dispatch_arms { $crate ($topic) $T ($ticked) $M ($other) })
    };
}

/// Expands to a `match` with one arm per line of the table. `$in` is the crate that defines the
/// topics and the payloads.
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

/// Expands to the body of one match arm.
#[doc(hidden)]
#[macro_export]
macro_rules! dispatch_arm {
    (no_tick $in:tt $payload:ident $T:ident ($ticked:expr) $M:ident ($other:expr)) => {{
        #[allow(dead_code, reason = "the expression may not use the type")]
        type $M = $in::$payload;
        $other
    }};
    ($presence:ident $in:tt $payload:ident $T:ident ($ticked:expr) $M:ident ($other:expr)) => {{
        #[allow(dead_code, reason = "the expression may not use the type")]
        type $T = $in::$payload;
        $ticked
    }};
}

graph::topics!(bind_payloads { Topic });

#[cfg(test)]
mod tests {
    //! Tests that a line added to the table, together with its payload, gets everything that is
    //! derived from the table.
    use crate::{Flags, Message, Ticked};

    macro_rules! added_lines {
        ($($callback:ident)::+ { $($argument:tt)* }) => {
            $($callback)::+! { { $($argument)* }
                Pressure = "pressure": PressureSample, flagged(GAP), Path, ingest => [fuser];
                Brake = "brake": BrakeState, no_tick, Control, feeders => [ingest];
            }
        };
    }

    /// Passes the system's topic table, followed by the added lines, to `$callback`.
    macro_rules! extended_table {
        ({ $($callback:ident)::+ { $($argument:tt)* } } $($line:tt)*) => {
            graph::topics! { $($callback)::+ { $($argument)* } $($line)* }
        };
    }

    #[expect(unreachable_pub, reason = "`payload!` declares public types")]
    mod extended {
        pub(super) mod graph {
            use ::graph;
            added_lines!(extended_table { graph::define_topics {} });
        }

        pub(super) use crate::*;

        crate::layout::payload! {
            /// Air pressure.
            PressureSample = "plumbline.PressureSample.1" {
                /// Tick, interval, flags.
                header: Header,
                /// Static pressure, Pa.
                pressure_pa: f64,
            }
        }

        crate::layout::payload! {
            /// State of the brakes.
            BrakeState = "plumbline.BrakeState.1" at (|state| Some(state.t_ns)) {
                /// Time of the state, ns.
                t_ns: i64,
            }
        }
    }

    use extended::{BrakeState, PressureSample, graph::Topic};

    added_lines!(bind_payloads { Topic });

    fn type_summary(topic: Topic) -> (&'static str, usize, Option<Flags>) {
        added_lines!(extended_table { crate::dispatch_arms { extended (topic) T ((T::TYPE, size_of::<T>(), Some(T::FLAG))) M ((M::TYPE, size_of::<M>(), None)) } })
    }

    #[test]
    fn added_payload_implements_the_traits_of_its_line() {
        assert_eq!((PressureSample::TOPIC.name, PressureSample::FLAG), ("pressure", Flags::GAP));
        assert_eq!(BrakeState::TOPIC.index, crate::graph::Topic::ALL.len() + 1);
        let mut sample: PressureSample = bytemuck::Zeroable::zeroed();
        sample.header_mut().t_end_ns = 5;
        assert_eq!((sample.source_time_ns(), BrakeState { t_ns: 7 }.source_time_ns()), (Some(5), Some(7)));
    }

    #[test]
    fn added_payload_layout_includes_topic_and_header() {
        let layout = PressureSample::layout();
        assert_eq!((layout.topic, layout.size, layout.header_fields), (Some("pressure"), 72, 9));
        assert_eq!(layout.fields.last().map(|field| (field.name, field.offset)), Some(("pressure_pa", 64)));
    }

    #[test]
    fn dispatch_covers_added_topics() {
        assert_eq!(type_summary(Topic::Pressure), ("plumbline.PressureSample.1", 72, Some(Flags::GAP)));
        assert_eq!(type_summary(Topic::Brake), ("plumbline.BrakeState.1", 8, None));
        assert_eq!(type_summary(Topic::Imu), ("plumbline.ImuSample.1", 112, Some(Flags::NONE)));
    }
}
