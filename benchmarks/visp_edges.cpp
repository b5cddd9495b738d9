// ViSP's model-based edge tracker on single photos, for benchmarks/locate_peers.py.
//
//     visp_edges MODEL.cao THRESHOLD SAMPLE_STEP GOOD RANGExROUNDS [RANGExROUNDS ...] < jobs > poses
//
// jobs: fx fy u0 v0, then a line for each: a picture (PGM, no blanks in its path), 9 entries of the start rotation
// camera_from_part row by row, 3 of the translation in metres. poses: a line for each: the same 12 numbers where it
// ended, the CPU seconds of all threads, whether the tracker called itself lost (1) or not (0).
//
// For each RANGE in px along normals the tracker is set to the last pose and looks at the photo ROUNDS times.

#include <cstdlib>
#include <ctime>
#include <iomanip>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>
#include <visp3/core/vpException.h>
#include <visp3/io/vpImageIo.h>
#include <visp3/mbt/vpMbGenericTracker.h>

namespace {

struct Stage {
  unsigned range, rounds;
};

std::vector<Stage> stages(int n, char **words) {
  std::vector<Stage> all;
  for (int k = 0; k < n; ++k) {
    std::istringstream word(words[k]);
    Stage s{};
    char cross = 0;
    word >> s.range >> cross >> s.rounds;
    if (!word || cross != 'x') throw std::runtime_error("not RANGExROUNDS: " + word.str());
    all.push_back(s);
  }
  return all;
}

// What ViSP's tutorial on its generic tracker sets.
vpMe moving_edges(double threshold, double sample_step) {
  vpMe me;
  me.setMaskSize(5);
  me.setMaskNumber(180);
  me.setThreshold(threshold);
  me.setMu1(0.5);
  me.setMu2(0.5);
  me.setSampleStep(sample_step);
  return me;
}

// Returns whether the tracker was lost; `pose` is then that of the last round that was not.
bool track(vpMbGenericTracker &tracker, vpMe me, const vpImage<unsigned char> &photo, const std::vector<Stage> &plan,
           vpHomogeneousMatrix &pose) {
  try {
    for (const Stage &stage : plan) {
      me.setRange(stage.range);
      tracker.setMovingEdge(me);
      tracker.setPose(photo, pose);
      for (unsigned k = 0; k < stage.rounds; ++k) {
        tracker.track(photo);
        tracker.getPose(pose);
      }
    }
  } catch (const vpException &) {
    return true;
  }
  return false;
}

} // namespace

int main(int argc, char **argv) {
  if (argc < 6) return std::cerr << "usage: visp_edges MODEL.cao THRESHOLD SAMPLE_STEP GOOD RANGExROUNDS ...\n", 2;
  std::ostream poses(std::cout.rdbuf()); // ViSP writes to std::cout
  std::cout.rdbuf(std::cerr.rdbuf());
  double fx, fy, u0, v0;
  std::cin >> fx >> fy >> u0 >> v0;
  vpMbGenericTracker tracker(1, vpMbGenericTracker::EDGE_TRACKER);
  tracker.setCameraParameters(vpCameraParameters(fx, fy, u0, v0));
  tracker.setAngleAppear(vpMath::rad(70)); // as the tutorial
  tracker.setAngleDisappear(vpMath::rad(80));
  tracker.setGoodMovingEdgesRatioThreshold(std::atof(argv[4]));
  tracker.setScanLineVisibilityTest(true); // hidden lines are not tracked
  const vpMe me = moving_edges(std::atof(argv[2]), std::atof(argv[3]));
  tracker.setMovingEdge(me);
  tracker.loadModel(argv[1]);
  tracker.setUseEdgeTracking("surface", false);
  const std::vector<Stage> plan = stages(argc - 5, argv + 5);
  std::string path, known;
  vpImage<unsigned char> photo;
  while (std::cin >> path) {
    vpHomogeneousMatrix pose;
    for (unsigned k = 0; k < 12; ++k) std::cin >> pose[k < 9 ? k / 3 : k - 9][k < 9 ? k % 3 : 3];
    if (path != known) vpImageIo::read(photo, known = path);
    const std::clock_t began = std::clock();
    const bool lost = track(tracker, me, photo, plan, pose);
    const double seconds = double(std::clock() - began) / CLOCKS_PER_SEC;
    poses << std::setprecision(12);
    for (unsigned k = 0; k < 12; ++k) poses << pose[k < 9 ? k / 3 : k - 9][k < 9 ? k % 3 : 3] << ' ';
    poses << seconds << ' ' << lost << std::endl;
  }
}
