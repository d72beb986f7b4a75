//! Decoding of the messages of a ULog.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::Path,
};

use attitude::frames::Body;
use px4_ulog::stream_parser::DataMessage;

use super::{
    fields::{
        AttitudeFields, CombinedFields, HealthFields, IntegratedFields, MagnetometerFields, ReceiverFields,
        VectorFields,
    },
    kind::Kind,
};
use crate::{
    ImportError,
    row_writer::{Attitude, Sample},
    source::{Inertial, ReceiverFix},
    timeline::Timed,
};

const UT_PER_GA: f64 = 100.0;

/// Content of a message in native axes and units.
#[derive(Debug, Clone, Copy)]
pub(super) enum Measurement {
    Inertial(Inertial),
    Field(Sample),
    Attitude(Attitude),
    Fix(ReceiverFix),
}

impl Measurement {
    pub(super) fn t_ns(&self) -> i64 {
        match self {
            Self::Inertial(inertial) => inertial.t_ns(),
            Self::Field(field) => field.t_ns(),
            Self::Attitude(attitude) => attitude.t_ns,
            Self::Fix(fix) => fix.t_ns,
        }
    }

    /// Returns the vectors of the measurement.
    pub(super) fn values(&self) -> [Option<[f64; 3]>; 2] {
        match self {
            Self::Inertial(Inertial { rate, force }) => [rate, force].map(|vector| vector.map(|(_, vector)| vector)),
            Self::Field((_, field_ut)) => [Some(*field_ut), None],
            Self::Attitude(_) => [None; 2],
            Self::Fix(fix) => [Some(fix.velocity_m_s), None],
        }
    }

    /// Returns `false` for a magnetic field with a component that is not finite. Rates and forces
    /// that are not finite are imported, because ingest rejects such readings later.
    pub(super) fn is_finite(&self) -> bool {
        match self {
            Self::Field((_, field_ut)) => field_ut.iter().all(|part| part.is_finite()),
            _ => true,
        }
    }
}

/// Layout of the messages of a kind.
pub(super) enum Layout {
    Combined(CombinedFields),
    CombinedField(CombinedFields),
    Integrated(IntegratedFields),
    Rate(VectorFields),
    Force(VectorFields),
    Field(MagnetometerFields),
    RawField(VectorFields),
    Attitude(AttitudeFields),
    Fix(ReceiverFields),
    Health(HealthFields),
}

/// Layouts found so far.
#[derive(Default)]
pub(super) struct Layouts(BTreeMap<Kind, Option<Layout>>);

impl Layouts {
    /// Returns the layout of a kind; `None` if the format of its topic is not supported.
    ///
    /// # Errors
    ///
    /// Returns an error if a required field is missing from a main topic, such as `sensor_combined`
    /// or `vehicle_attitude`.
    pub(super) fn find(
        &mut self,
        path: &Path,
        kind: Kind,
        message: &DataMessage,
    ) -> Result<Option<&Layout>, ImportError> {
        if let Entry::Vacant(entry) = self.0.entry(kind) {
            let layout = match kind {
                Kind::Combined => Some(Layout::Combined(CombinedFields::new(path, message)?)),
                Kind::CombinedField => {
                    let fields = CombinedFields::new(path, message)?;
                    fields.has_field().then_some(Layout::CombinedField(fields))
                }
                Kind::Field => Some(Layout::Field(MagnetometerFields::new(path, message)?)),
                Kind::Attitude => Some(Layout::Attitude(AttitudeFields::new(path, message)?)),
                Kind::Fix | Kind::RawFix => Some(Layout::Fix(ReceiverFields::new(path, message)?)),
                Kind::Integrated => IntegratedFields::new(message).map(Layout::Integrated),
                Kind::Rate => VectorFields::new(message).map(Layout::Rate),
                Kind::Force => VectorFields::new(message).map(Layout::Force),
                Kind::RawField => VectorFields::new(message).map(Layout::RawField),
                Kind::Health => HealthFields::new(message).map(Layout::Health),
            };
            entry.insert(layout);
        }
        Ok(self.0.get(&kind).and_then(Option::as_ref))
    }
}

impl Layout {
    /// Decodes a message; `None` if its time or its content is invalid.
    pub(super) fn decode(&self, data: &[u8]) -> Option<Measurement> {
        let native = |(t_ns, vector): (i64, [f32; 3])| (t_ns, Body::Frd.to_native(vector.map(f64::from)));
        let field_ut = |(t_ns, field_ga): (i64, [f32; 3])| {
            let field_ut = field_ga.map(|part| f64::from(part) * UT_PER_GA);
            Measurement::Field((t_ns, Body::Frd.to_native(field_ut)))
        };
        Some(match self {
            Self::Combined(fields) => {
                Measurement::Inertial(Inertial { rate: Some(fields.rate(data)?), force: fields.force(data) })
            }
            Self::CombinedField(fields) => field_ut(fields.field(data)?),
            Self::Integrated(fields) => {
                let (t_ns, [rate_rad_s, force_m_s2]) = fields.means(data)?;
                let [rate_rad_s, force_m_s2] = [rate_rad_s, force_m_s2].map(|vector| Body::Frd.to_native(vector));
                Measurement::Inertial(Inertial::joint(t_ns, rate_rad_s, force_m_s2))
            }
            Self::Rate(fields) => {
                Measurement::Inertial(Inertial { rate: Some(native(fields.vector(data)?)), force: None })
            }
            Self::Force(fields) => {
                Measurement::Inertial(Inertial { rate: None, force: Some(native(fields.vector(data)?)) })
            }
            Self::Field(fields) => field_ut(fields.field(data)?),
            Self::RawField(fields) => field_ut(fields.vector(data)?),
            Self::Attitude(fields) => Measurement::Attitude(fields.attitude(data)?),
            Self::Fix(fields) => Measurement::Fix(fields.fix(data)?),
            Self::Health(_) => return None,
        })
    }

    /// Returns the devices that a message of a sensor comes from.
    pub(super) fn devices(&self, data: &[u8]) -> impl Iterator<Item = (Kind, u32)> {
        let devices = match self {
            Self::Integrated(fields) => fields.devices(data),
            Self::Rate(fields) => [fields.device(data).map(|device| (Kind::Rate, device)), None],
            Self::Force(fields) => [fields.device(data).map(|device| (Kind::Force, device)), None],
            _ => [None; 2],
        };
        devices.into_iter().flatten()
    }

    /// Returns the health of each device.
    pub(super) fn health(&self, data: &[u8]) -> Vec<((Kind, u32), bool)> {
        match self {
            Self::Health(fields) => fields.health(data),
            _ => Vec::new(),
        }
    }
}
