"""Times GTSAM on a g2o file: python3 gtsam_pose_graph.py FILE; prints CPU seconds and chi2 (not halved)."""

import sys
import time

import gtsam

is_3d = "SE3" in open(sys.argv[1]).read(400)
graph, initial = gtsam.readG2o(sys.argv[1], is_3d)
if is_3d:
    graph.add(gtsam.PriorFactorPose3(0, initial.atPose3(0), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
else:
    graph.add(gtsam.PriorFactorPose2(0, initial.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
parameters = gtsam.GaussNewtonParams()
parameters.setRelativeErrorTol(1e-9)
begin = time.process_time()
result = gtsam.GaussNewtonOptimizer(graph, initial, parameters).optimize()
print(time.process_time() - begin, 2 * graph.error(result))
