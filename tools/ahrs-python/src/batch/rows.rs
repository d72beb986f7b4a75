//! Rows of a batch: one value or one vector per sample.

use std::ops::Range;

use plumbline_ahrs::{Frame, attitude::course::DeferredAngles, parts::DeferredAttitude};

use super::pages::Location;

/// Values of the attitudes, row by row.
pub(super) struct Rows {
    pub(super) frame: Frame,
    pub(super) quaternion: Vec<[f64; 4]>,
    /// Values from which the angles and the headings are computed.
    pub(super) angles: Vec<DeferredAngles>,
    pub(super) heading_sd_rad: Vec<f64>,
    pub(super) inclination_sd_rad: Vec<f64>,
    pub(super) rate_rad_s: Vec<[f64; 3]>,
    pub(super) gyro_bias_rad_s: Vec<[f64; 3]>,
    pub(super) flags: Vec<u64>,
    pub(super) tick: Vec<u64>,
    pub(super) reset_counter: Vec<u64>,
}

impl Rows {
    /// Creates rows with room for `len` attitudes in a frame.
    pub(super) fn with_capacity(len: usize, frame: Frame) -> Self {
        Self {
            frame,
            quaternion: Vec::with_capacity(len),
            angles: Vec::with_capacity(len),
            heading_sd_rad: Vec::with_capacity(len),
            inclination_sd_rad: Vec::with_capacity(len),
            rate_rad_s: Vec::with_capacity(len),
            gyro_bias_rad_s: Vec::with_capacity(len),
            flags: Vec::with_capacity(len),
            tick: Vec::with_capacity(len),
            reset_counter: Vec::with_capacity(len),
        }
    }

    /// Returns the memory of the rows. It is valid until more rows are appended than the capacity.
    pub(super) fn memory(&self) -> Memory {
        Memory([
            Location::new(&self.quaternion),
            Location::new(&self.angles),
            Location::new(&self.heading_sd_rad),
            Location::new(&self.inclination_sd_rad),
            Location::new(&self.rate_rad_s),
            Location::new(&self.gyro_bias_rad_s),
            Location::new(&self.flags),
            Location::new(&self.tick),
            Location::new(&self.reset_counter),
        ])
    }

    #[inline]
    pub(super) fn push(&mut self, attitude: &DeferredAttitude) {
        self.quaternion.push(attitude.quaternion_in(self.frame));
        self.angles.push(attitude.angles());
        self.heading_sd_rad.push(attitude.heading_sd_rad());
        self.inclination_sd_rad.push(attitude.inclination_sd_rad());
        self.rate_rad_s.push(attitude.rate_rad_s_in(self.frame));
        self.gyro_bias_rad_s.push(attitude.gyro_bias_rad_s_in(self.frame));
        self.flags.push(attitude.flags().0);
        self.tick.push(attitude.tick());
        self.reset_counter.push(attitude.reset_counter());
    }
}

/// Memory of [`Rows`], one location per column.
#[derive(Clone, Copy)]
pub(super) struct Memory([Location; 9]);

impl Memory {
    /// Provides the memory of rows, so that [`Rows::push`] does not wait for the kernel.
    pub(super) fn provide(self, rows: Range<usize>) {
        self.0.into_iter().for_each(|column| column.provide_pages(rows.clone()));
    }
}
