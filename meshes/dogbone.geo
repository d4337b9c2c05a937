// Dog-bone for tension along x: two grips joined by a narrower gauge section.
// Lengths in m. The fillets are circular arcs, tangent to the gauge section.
DefineConstant[
  grip_length = {0.20}, grip_width = {0.30},
  gauge_length = {0.50}, gauge_width = {0.20}, size = {0.04}
];
r = (grip_width - gauge_width) / 2;  // fillet radius
H = grip_width / 2;
h = gauge_width / 2;
x1 = grip_length;
x2 = x1 + r;
x3 = x2 + gauge_length;
x4 = x3 + r;
L = x4 + grip_length;
// lower side, left to right
Point(1) = {0, -H, 0, size};
Point(2) = {x1, -H, 0, size};
Point(3) = {x2, -h, 0, size};
Point(4) = {x3, -h, 0, size};
Point(5) = {x4, -H, 0, size};
Point(6) = {L, -H, 0, size};
// upper side, right to left
Point(7) = {L, H, 0, size};
Point(8) = {x4, H, 0, size};
Point(9) = {x3, h, 0, size};
Point(10) = {x2, h, 0, size};
Point(11) = {x1, H, 0, size};
Point(12) = {0, H, 0, size};
// fillet centres
Point(21) = {x2, -H, 0};
Point(22) = {x3, -H, 0};
Point(23) = {x3, H, 0};
Point(24) = {x2, H, 0};
Line(1) = {1, 2};
Circle(2) = {2, 21, 3};
Line(3) = {3, 4};
Circle(4) = {4, 22, 5};
Line(5) = {5, 6};
Line(6) = {6, 7};
Line(7) = {7, 8};
Circle(8) = {8, 23, 9};
Line(9) = {9, 10};
Circle(10) = {10, 24, 11};
Line(11) = {11, 12};
Line(12) = {12, 1};
Curve Loop(1) = {1:12};
Plane Surface(1) = {1};
Physical Curve("left") = {12};
Physical Curve("right") = {6};
Physical Curve("bottom") = {1:5};
Physical Curve("top") = {7:11};
Physical Surface("sheet") = {1};
