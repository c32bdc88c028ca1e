//! Reference lines.

#[cfg(test)]
pub(crate) mod tests {
    use crate::map::Scenario;
    use std::path::{Path, PathBuf};

    /// The folder of real files, if it is there; says so if not.
    pub(crate) fn real_data(kind: &str) -> Option<PathBuf> {
        let root = std::env::var_os("STOPLINE_DATA")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
        let folder = root.join(kind);
        if !folder.is_dir() {
            println!("skipped: no {kind} files (set STOPLINE_DATA)");
            return None;
        }
        Some(folder)
    }

    /// All scenarios that can be read, in order of their names.
    pub(crate) fn real_scenarios(folder: &Path) -> Vec<(String, Scenario)> {
        let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
        paths.retain(|p| p.extension().is_some_and(|e| e == "xml"));
        paths.sort();
        let name = |p: &Path| p.file_stem().unwrap().to_string_lossy().into_owned();
        paths.iter().filter_map(|p| crate::io::commonroad::read_file(p).ok().map(|s| (name(p), s))).collect()
    }
}

use crate::geometry::*; use crate::geometry::spiral::PathPoint; use crate::map::*; use crate::geometry::polyline::Polyline;
#[allow(missing_docs)] #[derive(Debug,Clone,Default)] pub struct Settings{}
#[allow(missing_docs)] #[derive(Clone)] pub struct ReferenceLine{ line: Polyline, k: Vec<f64>, yaw: Vec<f64>, ids: Vec<(f64,LaneletId)>, half: f64, lim: Vec<Option<f64>> }
#[allow(missing_docs)] #[allow(clippy::all)] impl ReferenceLine { 
 pub fn new(n:&RoadNetwork,c:&[LaneletId],_w:f64,_s:&Settings)->Result<Self,()> {
  let mut pts=vec![]; let mut ids=vec![]; let mut len=0.0; let mut lim=vec![];
  for id in c { let l=&n.lanelets[id]; ids.push((len,*id)); lim.push(l.speed_limit); len+=l.centre.length(); pts.extend(l.centre.points().iter().copied()); }
  let raw=Polyline::new(pts).ok_or(())?; let mut p=raw.resampled(1.0);
  for _ in 0..40 { let q=p.clone(); for i in 1..p.len()-1 { p[i]=Point::from((q[i-1].coords+q[i].coords*2.0+q[i+1].coords)/4.0); } }
  let line=Polyline::new(p).ok_or(())?; let m=line.points().len();
  let mut yaw:Vec<f64>=(0..m).map(|i| { let a=line.points()[i.saturating_sub(1)]; let b=line.points()[(i+1).min(m-1)]; (b.y-a.y).atan2(b.x-a.x)}).collect();
  for i in 1..m { yaw[i]=yaw[i-1]+wrap_angle(yaw[i]-yaw[i-1]); }
  let k=(0..m).map(|i| { let (a,b)=(i.saturating_sub(1),(i+1).min(m-1)); (yaw[b]-yaw[a])/(line.stations()[b]-line.stations()[a])}).collect();
  Ok(Self{line,k,yaw,ids,half:1.75,lim}) }
 pub fn length(&self)->f64{self.line.length()} 
 pub fn at(&self,s:f64)->PathPoint{ let st=self.line.stations(); let i=st.partition_point(|x|*x<=s).clamp(1,st.len()-1)-1; let r=(s-st[i])/(st[i+1]-st[i]); PathPoint{pose:Pose{position:self.line.at(s),yaw:self.yaw[i]+r*(self.yaw[i+1]-self.yaw[i])},curvature:self.k[i]+r*(self.k[i+1]-self.k[i]),curvature_rate:0.0} } 
 pub fn project(&self,p:Point)->(f64,f64){ let q=self.line.project(p);(q.station,q.offset)} 
 pub fn offset_pose(&self,s:f64,l:f64)->Option<(Pose,f64)>{ let p=self.at(s); let d=1.0-p.curvature*l; if d<0.2 {return None} Some((Pose{position:p.pose.position+p.pose.left()*l,yaw:p.pose.yaw},p.curvature/d)) }
 pub fn lane_bounds(&self,_s:f64)->(f64,f64){(self.half,-self.half)} 
 pub fn speed_limit(&self,s:f64)->Option<f64>{ let i=self.ids.partition_point(|x|x.0<=s).max(1)-1; self.lim[i]}
 pub fn lanelet_at(&self,s:f64)->LaneletId{ let i=self.ids.partition_point(|x|x.0<=s).max(1)-1; self.ids[i].1 } }
