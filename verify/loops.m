% Closed loops of random systems by Octave's control package, from physical data alone.
%
% usage: octave loops.m IN.mat OUT.mat
%
% The plant is M q'' + C q' + K q = f with modal damping; mirror, reaction mass and proof masses are bodies on
% springs. The loop is closed by `feedback`, norms are those of `norm`.

1;

function body = on_spring (inertia, frequency, ratio)
  body = [inertia, inertia * frequency^2, 2 * ratio * frequency * inertia];
endfunction

function found = one_loop (s)
  [shapes, squares] = eig ((s.K + s.K') / 2, (s.M + s.M') / 2);
  [squares, order] = sort (diag (squares));
  shapes = shapes(:, order);
  shapes = shapes ./ sqrt (diag (shapes' * s.M * shapes))';
  rigid = squares < 1e-10 * squares(end);
  w = sqrt (max (squares, 0));
  found.frequency = w(! rigid);
  z = s.damping_ratio * ones (size (w));
  if (strcmp (s.hub_type, "held"))
    w(rigid) = s.hub_bandwidth;
    z(rigid) = s.hub_damping;
  elseif (strcmp (s.hub_type, "free"))
    w(rigid) = 0;
    z(rigid) = 0;
  endif
  n = numel (w);
  tip = shapes' * s.tip;
  middle = shapes' * s.middle;
  hub = shapes' * s.hub;

  % Bodies on springs: mirror, its reaction mass, proof masses.
  bodies = on_spring (s.mirror(1), s.mirror(2), s.mirror(3));
  mounts = tip;
  if (! isempty (s.shares))
    j = s.shares(1) * s.mirror(1);
    k = s.shares(2) * s.mirror(1) * s.mirror(2)^2;
    bodies(end + 1, :) = on_spring (j, sqrt (k / j), s.mirror(3));
    mounts(:, end + 1) = tip;
  endif
  for i = 1:rows (s.actuators)
    a = s.actuators(i, :);
    bodies(end + 1, :) = on_spring (a(1), a(2), a(3)) + [0, 0, a(4)];
    mounts(:, end + 1) = middle;
  endfor
  b = rows (bodies);
  M = blkdiag (eye (n), diag (bodies(:, 1)));
  C = blkdiag (diag (2 * z .* w), zeros (b));
  K = blkdiag (diag (w.^2), zeros (b));
  for i = 1:b
    stretch = [-mounts(:, i); zeros(b, 1)];
    stretch(n + i) = 1;
    K += bodies(i, 2) * (stretch * stretch');
    C += bodies(i, 3) * (stretch * stretch');
  endfor

  % Torques: control, on the mirror, on the hub; measured: mirror, sensed angle.
  places = {tip, tip, middle};
  mirror = [zeros(n + b, 1)];
  mirror(n + 1) = 1;
  reacting = [places{s.reaction + 1}; zeros(b, 1)];
  sensed = mirror;
  acting = mirror;
  if (s.sensor > 0)
    sensed = [places{s.sensor + 1}; zeros(b, 1)];
    acting = sensed;
  endif
  control = acting - reacting;
  if (! isempty (s.shares))
    counter = zeros (n + b, 1);
    counter(n + 2) = 1;
    control -= s.shares(3) * (counter - reacting);
  endif
  loads = [control, mirror, [hub; zeros(b, 1)]];
  A = [zeros(n + b), eye(n + b); -(M \ K), -(M \ C)];
  B = [zeros(n + b, 3); M \ loads];
  plant = ss (A, B, [mirror', zeros(1, n + b); sensed', zeros(1, n + b)], zeros (2, 3));

  p = num2cell (s.pid);
  [gain, kp, ki, kd, lag] = p{:};
  pid = gain * ss (tf ([kp * lag + kd, kp + ki * lag, ki], [lag, 1, 0]));

  % Torques inside leave the momentum of a free body at zero: motions without any are all they move.
  drifting = 2 * strcmp (s.hub_type, "free");
  within = ss (A, B(:, 1), plant.c, zeros (2, 1));
  if (drifting)
    still = null (null (K)' * M);
    m = columns (still);
    masses = still' * M * still;
    inside = [zeros(m), eye(m); -(masses \ (still' * K * still)), -(masses \ (still' * C * still))];
    moving = [still, zeros(n + b, m)];
    within = ss (inside, [zeros(m, 1); masses \ (still' * control)], [mirror'; sensed'] * moving, zeros (2, 1));
  endif
  found.sampled = sampled_loop (ss (A, B(:, 1), plant.c(2, :), 0), within(2, 1), s);

  % u = -pid (sensed + noise) enters the first torque.
  noisy = [plant, [0; 1]];
  closed = feedback (noisy, pid, 1, 2, -1);
  found.poles = eig (closed.a);
  response = freqresp (closed, s.frequency(:)');
  mirror_by = permute (response(1, [2, 3, 4], :), [2, 3, 1]);
  % Line of sight: what moves the mirror through the sensor, plus the displacement itself.
  found.responses = [mirror_by(1, :); mirror_by(2, :); 1 + mirror_by(3, :); mirror_by(3, :)];
  % The drift of a free body, two poles at zero, is no part of the norms.
  decaying = sort (real (found.poles), "descend");
  found.stable = decaying(drifting + 1) < 0;
  found.rms = zeros (0, 1);
  found.largest_sensitivity = zeros (0, 1);
  if (! found.stable)
    return;
  endif
  if (drifting)
    plant = within;
    closed = feedback ([plant, [0; 1]], pid, 1, 2, -1);
    closed = [closed(1, 1), closed(1, 1), closed(1, 1), closed(1, 2)];
  endif
  low = ss (tf (sqrt (2 * s.low_corner), [1, s.low_corner]));
  high = ss (tf (1e-8 / sqrt (2) * [1, 0], [1, s.high_corner]));
  found.rms = [norm((1 + closed(1, 4)) * low * 1e-5, 2); norm(closed(1, 4) * high, 2)];
  if (! drifting)
    found.rms(3) = norm (closed(1, 2) * low * 0.02, 2);
  endif
  try
    found.largest_sensitivity = norm (feedback (ss (1), plant(2, 1) * pid), Inf, 1e-12);
  catch
    % SLICOT's QZ iteration sometimes does not converge: said by a missing number.
    found.largest_sensitivity = NaN;
  end_try_catch
endfunction

function delayed = on_hold (plant, s)
  % Zero-order hold whose torque changes a computation delay after the sample: two holds to a period.
  period = s.period;
  late = rem (s.delay, period);
  whole = floor (s.delay / period);
  first = c2d (plant, late, "zoh");
  second = c2d (plant, period - late, "zoh");
  z = tf ("z", period);
  held = ss (second.a * first.a, [second.a * first.b, second.b], plant.c, [0, 0], period);
  delayed = held * [1 / z^(whole + 1); 1 / z^whole];
endfunction

function found = sampled_loop (plant, within, s)
  % Poles of the plant that drifts, the norm of what moves within it.
  period = s.period;
  z = tf ("z", period);
  p = num2cell (s.pid);
  [gain, kp, ki, kd, lag] = p{:};
  if (s.backward)
    pid = ss (gain * (kp + ki * period / 2 * (z + 1) / (z - 1) + kd * (z - 1) / ((period + lag) * z - lag)));
  else
    pid = c2d (gain * ss (tf ([kp * lag + kd, kp + ki * lag, ki], [lag, 1, 0])), period, "tustin");
  endif
  delayed = on_hold (plant, s);
  closed = feedback (delayed * pid, 1);
  found.poles = eig (closed.a);
  found.loop = squeeze (freqresp (delayed * pid, s.sampled_frequency(:)'));
  found.largest_sensitivity = NaN;
  delayed = on_hold (within, s);
  if (max (abs (eig (feedback (delayed * pid, 1).a))) < 1)
    try
      found.largest_sensitivity = norm (feedback (1, delayed * pid), Inf, 1e-10);
    catch
    end_try_catch
  endif
endfunction

pkg load control;
files = argv ();
given = load (files{1});
systems = given.systems;
answers = cell (numel (systems), 1);
for i = 1:numel (systems)
  answers{i} = one_loop (systems{i});
endfor
save ("-v6", files{2}, "answers");
