//! placeholder until the branch lands
#![allow(missing_docs)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Status {
    Solved,
    AlmostSolved,
    Other,
}
pub struct Solution {
    pub status: Status,
    pub x: Vec<f64>,
}
pub struct QuadraticProgram {}
impl QuadraticProgram {
    pub fn new(_n: usize) -> Self {
        Self {}
    }
    pub fn add_squared_error(&mut self, _i: usize, _t: f64, _w: f64) {}
    pub fn add_equality(&mut self, _r: &[(usize, f64)], _b: f64) {}
    pub fn add_range(&mut self, _r: &[(usize, f64)], _l: f64, _u: f64) {}
    pub fn solve(&self) -> Solution {
        Solution { status: Status::Other, x: vec![] }
    }
}
