"""Adjusts a plane pose graph by Ceres with DCS on its loop edges: python3 ceres_dcs.py FILE.g2o.

Prints x and y of every vertex, in the order of the file. Error: translation of what is left of a relation in the frame
of the measured pose, wrapped angle. The loss is folded into the residuals, as the package has no DCS: r sqrt(rho(s)/s)
with s = r.r and, Phi = 1, rho = s up to 1 and 4 s / (1 + s) - 1 beyond (Agarwal et al. 2013, as a loss)."""

import math
import sys

import numpy as np
import pyceres


def upper_root(m):
    """R with R^T R the information matrix, given by its upper triangle row by row."""
    a, b, c, d, e, f = m
    return np.linalg.cholesky(np.array([[a, b, c], [b, d, e], [c, e, f]])).T


class Relation(pyceres.CostFunction):
    def __init__(self, measured, root, is_loop):
        super().__init__()
        self.set_num_residuals(3)
        self.set_parameter_block_sizes([3, 3])
        self.measured, self.root, self.is_loop = measured, root, is_loop
        self.turn = (math.cos(measured[2]), math.sin(measured[2]))

    def Evaluate(self, parameters, residuals, jacobians):
        a, b = parameters[0], parameters[1]
        c, s = math.cos(a[2]), math.sin(a[2])
        mc, ms = self.turn
        dx, dy = b[0] - a[0], b[1] - a[1]
        # in the first frame, less what was measured, turned to the frame of the measured pose
        px, py = c * dx + s * dy, c * dy - s * dx
        tx, ty = px - self.measured[0], py - self.measured[1]
        angle = b[2] - a[2] - self.measured[2]
        angle -= 2.0 * math.pi * round(angle / (2.0 * math.pi))
        r = self.root @ (mc * tx + ms * ty, mc * ty - ms * tx, angle)
        square = float(r @ r)
        scale, slope = 1.0, 0.0
        if self.is_loop and square > 1.0:
            rho, by = 4.0 * square / (1.0 + square) - 1.0, 4.0 / (1.0 + square) ** 2
            scale = math.sqrt(rho / square)
            slope = (by * square - rho) / (2.0 * square * square * scale)
        residuals[:] = scale * r
        if jacobians is not None:
            # rows: turned by -(heading + measured angle)
            tc, ts = c * mc - s * ms, s * mc + c * ms
            j = self.root @ np.array([
                [tc, ts, 0.0, mc * py - ms * px],
                [-ts, tc, 0.0, -mc * px - ms * py],
                [0.0, 0.0, 1.0, 0.0],
            ])
            j = scale * j + (2.0 * slope) * np.outer(r, r @ j)
            if jacobians[0] is not None:
                jacobians[0][:] = np.column_stack((-j[:, 0], -j[:, 1], j[:, 3] - j[:, 2])).ravel()
            if jacobians[1] is not None:
                jacobians[1][:] = j[:, :3].ravel()
        return True


vertices, edges = {}, []
for line in open(sys.argv[1]):
    words = line.split()
    if words and words[0] == "VERTEX_SE2":
        vertices[int(words[1])] = np.array([float(w) for w in words[2:5]])
    elif words and words[0] == "EDGE_SE2":
        numbers = [float(w) for w in words[3:12]]
        edges.append((int(words[1]), int(words[2]), numbers[:3], upper_root(numbers[3:])))
problem = pyceres.Problem()
kept = []
for i, j, measured, root in edges:
    kept.append(Relation(measured, root, abs(i - j) != 1))
    problem.add_residual_block(kept[-1], None, [vertices[i], vertices[j]])
problem.set_parameter_block_constant(next(iter(vertices.values())))
options = pyceres.SolverOptions()
options.linear_solver_type = pyceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
options.max_num_iterations = 200
options.function_tolerance = 1e-9
options.num_threads = 1
summary = pyceres.SolverSummary()
pyceres.solve(options, problem, summary)
for v in vertices.values():
    print(repr(float(v[0])), repr(float(v[1])))
