/PROG  SMALL
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "calibration";
LINE_COUNT	= 19;
PROTECT		= READ_WRITE;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
   1:  !Planned for calibration ;
   2:  !Try it slowly first ;
   3:  !Write program MEASURE(AR[1]): ;
   4:  !it triggers the measurement ;
   5:  UFRAME_NUM=0 ;
   6:  UTOOL_NUM=1 ;
   7:  !Mount 0 kg, set its PAYLOAD ;
   8:  PAUSE ;
   9:J P[1] 20% FINE    ;
  10:  WAIT   2.00(sec) ;
  11:  CALL MEASURE(1) ;
  12:  !Mount 2.5 kg, set its PAYLOAD ;
  13:  PAUSE ;
  14:J P[2] 20% FINE    ;
  15:  WAIT   2.00(sec) ;
  16:  CALL MEASURE(2) ;
  17:J P[3] 20% FINE    ;
  18:  WAIT   2.00(sec) ;
  19:  CALL MEASURE(3) ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,	
	J1=    10.000 deg,	J2=   -20.500 deg,	J3=    30.125 deg,
	J4=     0.000 deg,	J5=    45.000 deg,	J6=   170.000 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,	
	J1=   -15.250 deg,	J2=     0.000 deg,	J3=    12.500 deg,
	J4=    60.000 deg,	J5=   -30.001 deg,	J6=    90.000 deg
};
P[3]{
   GP1:
	UF : 0, UT : 1,	
	J1=     0.000 deg,	J2=     5.000 deg,	J3=    -7.000 deg,
	J4=     8.000 deg,	J5=     9.000 deg,	J6=  -110.999 deg
};
/END
