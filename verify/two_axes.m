% Both loops of mirrors with two axes by Octave's control package, from physical data alone.
%
% usage: octave two_axes.m IN.mat OUT.mat
%
% The plant is M q'' + C q' + K q = f with modal damping and the mirror as a body on a spring about each axis. Both
% loops are closed at once by `feedback` around a plant of two inputs and two outputs; norms are those of `norm`.

1;

function found = both_loops (s)
  [shapes, squares] = eig ((s.K + s.K') / 2, (s.M + s.M') / 2);
  [squares, order] = sort (diag (squares));
  shapes = shapes(:, order);
  shapes = shapes ./ sqrt (diag (shapes' * s.M * shapes))';
  w = sqrt (squares);
  n = numel (w);
  size_ = n + 2;
  M = blkdiag (eye (n), diag (s.mirrors(:, 1)));
  C = blkdiag (diag (2 * s.damping_ratio * w), zeros (2));
  K = blkdiag (diag (squares), zeros (2));
  control = zeros (size_, 2);
  for i = 1:2
    control(1:n, i) = -shapes' * s.ports(:, i);
    control(n + i, i) = 1;
    j = s.mirrors(i, 1);
    K += j * s.mirrors(i, 2)^2 * (control(:, i) * control(:, i)');
    C += 2 * s.mirrors(i, 3) * s.mirrors(i, 2) * j * (control(:, i) * control(:, i)');
  endfor
  mirrors = [zeros(n, 2); eye(2)];
  hubs = [shapes' * s.hubs; zeros(2)];
  A = [zeros(size_), eye(size_); -(M \ K), -(M \ C)];
  B = [zeros(size_, 6); M \ [control, mirrors, hubs]];
  plant = ss (A, B, [mirrors', zeros(2, size_)], zeros (2, 6));
  pid = ss ();
  for i = 1:2
    p = num2cell (s.pids(i, :));
    [gain, kp, ki, kd, lag] = p{:};
    own = gain * ss (tf ([kp * lag + kd, kp + ki * lag, ki], [lag, 1, 0]));
    if (i == 1)
      pid = own;
    else
      pid = append (pid, own);
    endif
  endfor
  noisy = ss (A, [B, zeros(2 * size_, 2)], plant.c, [zeros(2, 6), eye(2)]);
  closed = feedback (noisy, pid, [1, 2], [1, 2], -1);
  found.poles = eig (closed.a);
  % What is fed back carries the noise; the mirror's own angle does not, and the line of sight its displacement.
  fed = freqresp (closed, s.frequency(:)');
  noise = fed(:, 7:8, :) - repmat (eye (2), [1, 1, size(fed, 3)]);
  found.responses = cat (2, fed(:, 3:6, :), fed(:, 7:8, :), noise);
  found.stable = max (real (found.poles)) < 0;
  if (! found.stable)
    return;
  endif
  low = ss (tf (sqrt (2 * s.low_corner), [1, s.low_corner]));
  high = ss (tf (1e-8 / sqrt (2) * [1, 0], [1, s.high_corner]));
  angles = closed(:, 7:8) - eye (2);
  found.rms = [norm(closed(:, 7:8) * append (low, low) * 1e-5, 2); norm(angles * append (high, high), 2); ...
               norm(closed(:, 5:6) * append (low, low) * 0.02, 2)];
  found.largest_sensitivity = norm (closed(:, 7:8), Inf, 1e-12);
endfunction

pkg load control;
files = argv ();
given = load (files{1});
systems = given.systems;
answers = cell (numel (systems), 1);
for i = 1:numel (systems)
  answers{i} = both_loops (systems{i});
endfor
save ("-v6", files{2}, "answers");
