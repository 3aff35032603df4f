"""Registers two clouds with small_gicp's GICP: python3 small_gicp.py FIXED MOVING; prints CPU seconds and the shift
at the fixed cloud's mean [m]. The files hold x y z of every point as little-endian doubles, in a local frame."""

import sys
import time

sys.path.pop(0)  # this file has the package's name

import numpy as np
import small_gicp

fixed, moving = (np.fromfile(path).reshape(-1, 3) for path in sys.argv[1:3])
centre = fixed.mean(axis=0)
begin = time.process_time()
result = small_gicp.align(
    fixed - centre,
    moving - centre,
    registration_type="GICP",
    downsampling_resolution=0.25,
    max_correspondence_distance=1.0,
    num_threads=2,
)
seconds = time.process_time() - begin
shift = result.T_target_source[:3, 3]
print(seconds, *shift)
