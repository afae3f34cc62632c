-- Whether a record lacks more than one sample in a hundred of those that it should have, and more than a few.
create or replace macro lacks_samples(n, expected) as
  coalesce(expected - n > 2 and n < 0.99 * expected, false);
