Point(1)={1,0,0};
Point(2)={2,0,0};Point(3)={3,0,0};Point(4)={