/PROG  PART
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "P[1]{J1= 3 deg}";
LINE_COUNT	= 8;
/MN
   1:  !J P[9] 20% FINE ;
   2:  UFRAME_NUM=2 ;
   3:  UTOOL_NUM=3 ;
   4:J P[1:"home"] 20% FINE    ;
   5:L P[2] 200mm/sec CNT50 ACC80 ;
   6:C P[3]    
    :  P[4] 100mm/sec FINE    ;
   7:J P[5] 20% FINE    ;
   8:  WAIT   2.00(sec) ;
/POS
P[1:"home"]{
   GP1:
	UF : 2, UT : 3,	
	J1=    12.500 deg,	J2=    20.250 deg,	J3=    -4.125 deg,
	J4=   -18.500 deg,	J5=    48.000 deg,	J6=    31.750 deg
};
P[2]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =   712.804  mm,	Y =   226.655  mm,	Z =   475.801  mm,
	W =  -150.856 deg,	P =    21.980 deg,	R =   151.702 deg
   GP2:
	UF : 2, UT : 3,	
	J1=     5.000 deg
};
P[3]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =   676.164  mm,	Y =    81.650  mm,	Z =   308.245  mm,
	W =  -150.779 deg,	P =    17.267 deg,	R =   151.917 deg
};
P[4]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'N U T, 0, 0, 0',
	X =   574.618  mm,	Y =  -158.554  mm,	Z =   512.085  mm,
	W =  -138.688 deg,	P =    14.555 deg,	R =   156.248 deg
};
P[5]{
   GP1:
	UF : 2, UT : 3,	
	J1=     8.000 deg,	J2=    22.000 deg,	J3=     1.000 deg,
	J4=   -14.000 deg,	J5=    46.000 deg,	J6=    24.000 deg
};
/END