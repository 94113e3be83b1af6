MODULE FeederClient
  ! Picks parts from the feeder (docs/guide/feeder.md) with a robot of ABB. No robot has run this program; a test sends its
  ! commands to the feeder. Set the address, zPick [mm], pAbovePlate (its configuration and external axes), tGripper and
  ! wobjRobot (the frame of the feeder's replies). Write the functions hasPart, CloseGripper, LeavePlate and Place.

  VAR socketdev feeder;

  FUNC string Ask(string command, num longest)
    VAR rawbytes data;
    VAR rawbytes answer;
    VAR byte last := 0;
    VAR string line;
    IF SocketGetStatus(feeder) = SOCKET_CLOSED THEN
      SocketCreate feeder;
      SocketConnect feeder, "192.168.0.2", 7171;
    ENDIF
    SocketSend feeder \Str:=command + "\0A";
    WHILE last <> 10 DO                            ! a line can arrive in several pieces
      SocketReceive feeder \RawData:=data \Time:=longest;
      CopyRawBytes data, 1, answer, RawBytesLen(answer) + 1;
      UnpackRawBytes answer, RawBytesLen(answer), last \Hex1;
    ENDWHILE
    IF RawBytesLen(answer) > 82 THEN               ! maximum length of a string, plus CR and LF; the numbers are at the beginning
      UnpackRawBytes answer, 1, line \ASCII:=80;
    ELSE
      UnpackRawBytes answer, 1, line \ASCII:=RawBytesLen(answer) - 2;
    ENDIF
    RETURN line;
  ERROR
    SocketClose feeder;
    RETURN "no answer";
  ENDFUNC

  FUNC num Number(string line, string name)
    VAR num begin;
    VAR num value;
    begin := StrMatch(line, 1, name) + StrLen(name);
    IF NOT StrToVal(StrPart(line, begin, StrMatch(line, begin, " ") - begin), value) EXIT;
    RETURN value;
  ENDFUNC

  PROC Feed()
    VAR string line;
    VAR robtarget at;
    WHILE TRUE DO
      line := Ask("get_part 30", 35);
      IF StrPart(line, 1, 4) = "200 " THEN
        at := pAbovePlate;
        at.trans := [Number(line, " x="), Number(line, " y="), zPick];
        at.rot := OrientZYX(Number(line, " angle="), 0, 180);      ! the tool points down
        MoveL Offs(at, 0, 0, 100), v1000, z10, tGripper \WObj:=wobjRobot;
        MoveL at, v200, fine, tGripper \WObj:=wobjRobot;
        CloseGripper;                              ! says by hasPart whether it has the part
        MoveL Offs(at, 0, 0, 100), v1000, z10, tGripper \WObj:=wobjRobot;
        LeavePlate;                                ! ends with a fine point: others are left early
        IF hasPart THEN
          line := Ask("part_taken ok", 5);
          Place;
        ELSE
          line := Ask("part_taken failed", 5);
        ENDIF
      ELSE
        TPWrite line;
        WaitTime 1;
      ENDIF
    ENDWHILE
  ENDPROC
ENDMODULE
