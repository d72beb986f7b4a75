//! Rows of a batch: one value or one vector per sample.

use plumbline_ahrs::{Frame, attitude::course::DeferredAngles, parts::DeferredAttitude};

use super::pages::provide_pages;

/// Number of rows for which pages are provided in one call. They fit into the cache of a processor.
const ROWS_WITH_PAGES: usize = 2048;

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
    /// Number of rows for which pages were provided.
    with_pages: usize,
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
            with_pages: 0,
        }
    }

    fn provide_pages(&mut self) {
        let rows = ROWS_WITH_PAGES;
        self.with_pages += rows;
        provide_pages(&mut self.quaternion, rows);
        provide_pages(&mut self.angles, rows);
        provide_pages(&mut self.heading_sd_rad, rows);
        provide_pages(&mut self.inclination_sd_rad, rows);
        provide_pages(&mut self.rate_rad_s, rows);
        provide_pages(&mut self.gyro_bias_rad_s, rows);
        provide_pages(&mut self.flags, rows);
        provide_pages(&mut self.tick, rows);
        provide_pages(&mut self.reset_counter, rows);
    }

    #[inline]
    pub(super) fn push(&mut self, attitude: &DeferredAttitude) {
        if self.quaternion.len() == self.with_pages {
            self.provide_pages();
        }
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
